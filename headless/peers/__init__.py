"""Other renderers beside Lumigate: the neutral scene that all of them can show, its exporters, and `lumigate bench peers`."""
