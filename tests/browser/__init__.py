"""The viewer, built and in a real Chromium."""
