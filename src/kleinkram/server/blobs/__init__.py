"""Blobs: reading what arrived, verifying it, and letting go of what nobody refers to."""
