"""Executors run jobs: in containers (`docker`), or as processes of this machine (`process`)."""
