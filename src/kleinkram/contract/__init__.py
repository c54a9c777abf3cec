"""Wire nouns: what client and server say to each other. Imports nothing of ours, does nothing but judge shapes."""
