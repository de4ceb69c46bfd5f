"""What the program does not do, and what that saves: each skip is undone, the work is done, and both are counted."""
