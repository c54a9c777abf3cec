"""Blobs: reading what arrived, proving it, and letting go of what nobody refers to."""
