"""Maps of any point over named axes."""
