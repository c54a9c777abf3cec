"""People: lists, admin rights and deactivation."""
