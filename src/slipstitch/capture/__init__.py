"""Capture: what is measured on a real bench, brought into the project's terms."""
