"""User stories: `klein` as a subprocess against `klein up`."""
