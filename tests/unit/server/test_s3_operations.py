"""The names of requests to the store in metrics and traces are those of the S3 API."""

import pytest

from kleinkram.server.s3.client import S3Request


@pytest.mark.parametrize(
    ("request_", "name"),
    [
        (S3Request("POST", "k", {"uploads": ""}), "CreateMultipartUpload"),
        (S3Request("POST", "k", {"uploadId": "u"}), "CompleteMultipartUpload"),
        (S3Request("PUT", "k", {"uploadId": "u", "partNumber": "1"}), "UploadPart"),
        (S3Request("GET", "k", {"uploadId": "u", "part-number-marker": "7"}), "ListParts"),
        (S3Request("GET", "", {"uploads": "", "prefix": "p"}), "ListMultipartUploads"),
        (S3Request("GET", "", {"list-type": "2", "prefix": "p"}), "ListObjectsV2"),
        (S3Request("PUT", "", {"cors": ""}), "PutBucketCors"),
        (S3Request("HEAD", "k"), "HeadObject"),
        (S3Request("HEAD"), "HeadBucket"),
        (S3Request("PUT"), "CreateBucket"),
        (S3Request("GET", "k", headers={"Range": "bytes=0-1"}), "GetObject"),
        (S3Request("PUT", "k"), "PutObject"),
        (S3Request("DELETE", "k", {"uploadId": "u"}), "AbortMultipartUpload"),
        (S3Request("DELETE", "k"), "DeleteObject"),
        (S3Request("PATCH", "k"), "PATCH"),
    ],
)
def test_an_operation_has_its_name(request_: S3Request, name: str) -> None:
    assert request_.operation == name
