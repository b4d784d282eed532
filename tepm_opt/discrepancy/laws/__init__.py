"""Effects that any machine may have: where they act, their parameters with sizes worth a try, and their law."""
