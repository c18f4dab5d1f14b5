"""Parts of files: checked files, named fields, instants, units, HDF5 members."""
