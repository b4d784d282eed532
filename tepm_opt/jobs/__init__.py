"""Jobs: what each command computes and leaves in its folder; the library has the same functions."""
