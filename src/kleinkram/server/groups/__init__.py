"""Groups: made by people, or filled by what the settings say of e-mail domains."""
