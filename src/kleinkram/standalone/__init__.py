"""`klein up`: PostgreSQL, S3, API and worker of one machine under one supervisor. Importing it starts nothing."""
