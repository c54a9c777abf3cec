"""Images of containers without a container engine: fetched from registries, unpacked, and kept by digest."""
