"""Describe what data were taken under: settings, groups of values, and condition errors."""
