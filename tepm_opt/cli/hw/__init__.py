"""`tepm hw`: bringing a real robot into service, looking at it, and stopping it."""
