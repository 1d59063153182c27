"""What is made of maps: boundaries with a width, unions."""
