"""Files of the web app, built from `web/` and shipped in the wheel; `http/web_app.py` serves them."""
