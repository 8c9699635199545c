"""Find the object in an image: region of interest, segmentation rules, colour table, colour picker."""
