"""Actions: published definitions of what to run, in versions that never change."""
