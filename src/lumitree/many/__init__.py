"""Lists of lamps: `bake_many` makes a folder of assets, `page` its index page."""
