"""Capture: measurements on a real bench, converted to the project's formats."""
