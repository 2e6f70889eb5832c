"""The file formats that are read: one table, one importer a format.

Every importer gives the same thing, an `Imported`: the open tree as plain URDF text, and beside it
what a mechanism file would say (joints, closures, drivers, springs, guess), as `tomllib` reads
one. `spatial_pin.formats.files.load` asks the table and builds the mechanism.
"""
