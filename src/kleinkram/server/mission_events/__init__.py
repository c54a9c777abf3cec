"""Mission events: moments and spans of missions that people, programs and runs mark by name."""
