"""What emulators of all kinds have in common: a pseudo-terminal, a process of their own, and who starts it."""
