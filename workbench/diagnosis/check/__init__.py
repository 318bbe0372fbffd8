"""The check of records before a diagnosis: whether they are of the plant, and slips of the hand."""
