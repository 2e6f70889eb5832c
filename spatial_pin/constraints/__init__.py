"""The closure equations evaluated: of one configuration, of many together, of large trees."""
