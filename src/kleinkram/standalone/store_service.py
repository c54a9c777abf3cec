"""`python -m kleinkram.standalone.store_service OPTIONS`: becomes SeaweedFS with the options of `klein up`.

For a server of systemd units on one machine. It listens on loopback; a proxy gives other machines access to the bucket.
"""

import argparse
import os
import sys
from pathlib import Path
from typing import NoReturn

from kleinkram.standalone.errors import BinaryNotFound
from kleinkram.standalone.object_store import StoreFolder, locate_weed, prepare

# SeaweedFS's own, which no unit of ours uses for something else.
_PORTS = {"master": 9333, "volume": 9340, "filer": 8888, "admin": 23646}
_GRPC_PORTS = {"s3_grpc": 18333, "master_grpc": 19333, "volume_grpc": 19340, "filer_grpc": 18888}


def main() -> NoReturn:
    """Replace this process by the store."""
    options = _parser().parse_args()
    try:
        store = StoreFolder(
            program=locate_weed(),
            data_dir=options.folder,
            folder=options.folder,
            log=Path(os.devnull),
            ports={**_PORTS, **_GRPC_PORTS, "s3": options.port},
            access_key=options.access_key,
            secret_key=options.secret_key_file.read_text().strip(),
        )
        command = prepare(store)
        os.chdir(command.directory)
        os.execve(command.arguments[0], [*command.arguments], {**os.environ, **command.environment})  # noqa: S606  (no shell)
    except BinaryNotFound as error:
        sys.exit(str(error))
    except OSError as error:
        sys.exit(f"The store was not started: {error}.")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m kleinkram.standalone.store_service", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="where its files are")
    parser.add_argument("--port", type=int, required=True, help="its port for S3, on 127.0.0.1")
    parser.add_argument("--access-key", required=True)
    parser.add_argument("--secret-key-file", type=Path, required=True)
    return parser


if __name__ == "__main__":
    main()
