"""The column and its laws: physics, without a question asked."""
