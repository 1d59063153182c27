"""What others would use, each as its own users would write it."""
