"""From a view to grams: preparation, visible volume, interval, weigher."""
