"""Access: who is asking, and what they may see. Every query of every feature starts here."""
