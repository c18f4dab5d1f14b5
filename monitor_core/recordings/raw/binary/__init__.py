"""Read raw files that are no text: each format a module, each library imported where it is needed."""
