"""Groups of people: created by people, or affiliation groups that follow from domains in the settings."""
