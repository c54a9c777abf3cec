"""The app in the browser: built from `web/`, shipped in the wheel, served by the API itself."""
