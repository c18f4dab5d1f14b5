"""What files are made of: checked files, named fields, instants, units, HDF5 members."""
