"""What a controller can be asked for: one specification a file, found by name."""
