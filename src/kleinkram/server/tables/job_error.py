"""Why a job failed last, in a sentence: the queue itself keeps none.

A row goes with its job, by a foreign key that only the migration names: the queue's tables are not described here.
"""

from sqlalchemy import BigInteger, Column, Table, Text

from kleinkram.server.tables.base import metadata

job_error = Table(
    "job_error",
    metadata,
    Column("job_id", BigInteger, primary_key=True, autoincrement=False),
    Column("sentence", Text, nullable=False),
)
