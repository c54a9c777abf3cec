"""Signing in: who somebody is, by a provider's word, a password, or a link that is good once; sessions; logins."""
