"""Attribute a change of an axis at work against its own reference."""
