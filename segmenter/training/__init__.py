"""Training of the segmenter's network. The only part of the segmenter that needs torch; what runs never imports it."""
