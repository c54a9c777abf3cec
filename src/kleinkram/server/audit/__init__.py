"""The audit log: what happened, who did it, and who was refused."""
