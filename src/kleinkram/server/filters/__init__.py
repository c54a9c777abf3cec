"""What the filters of the contract mean in SQL: conditions on files, missions, projects and topics."""
