"""Files beside recordings: trajectories, tables, documents, flight logs. Recognised, and asked for what is cheap."""
