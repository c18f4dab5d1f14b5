"""From records to JSON documents, one module for each record."""
