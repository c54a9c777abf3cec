"""Tests of writing tables and images."""
