"""The object store: requests to any S3 service, signed URLs, and what a particular store can do."""
