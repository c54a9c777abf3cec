"""CRC-64/NVME, the checksum of whole objects in S3 (`x-amz-checksum-crc64nvme`, type FULL_OBJECT).

It can be combined: the checksum of a file follows from those of its parts, so a file is read once for both.
"""

import anycrc

_MODEL = anycrc.Model("CRC64-NVME")


def crc64nvme(data: bytes | memoryview, value: int = 0) -> int:
    """Return the CRC-64/NVME of `data`, continuing from `value`."""
    return int(_MODEL.calc(data, value))


def combine_crc64nvme(first: int, second: int, second_bytes: int) -> int:
    """Return the CRC-64/NVME of two byte strings one after the other; `second_bytes` is the size of the second."""
    return int(_MODEL.combine(first, second, second_bytes))
