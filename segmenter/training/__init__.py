"""Training of the classifier. The only part of the segmenter that needs torch; what runs never imports it."""
