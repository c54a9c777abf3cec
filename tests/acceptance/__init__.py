"""The stories of the issue: `klein` as a subprocess against `klein up`."""
