"""File formats: one table, one importer for each format.

Every importer returns an `Imported`: the open tree as plain URDF text, and the other tables of a
mechanism file (joints, closures, drivers, springs, guess), as `tomllib` reads them.
`spatial_pin.formats.files.load` takes the importer from the table and builds the mechanism.
"""
