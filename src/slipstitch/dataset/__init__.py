"""Sample: from rendered images to the dataset, its labels and its splits."""
