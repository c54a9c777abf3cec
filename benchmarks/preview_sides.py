"""The side of the benchmark of previews, run as a process of its own (see `side`)."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.side import Facts, main
from kleinkram import library
from kleinkram.action.testing import try_out

_PREVIEW = Path(library.__file__).parent / "preview.py"


def make_preview(folder: str) -> Facts:
    """Run the shipped action `preview` on a folder; the time includes copying the files, as inputs of the run."""
    root = Path(folder)
    files: dict[str, Path | bytes] = {
        str(path.relative_to(root)): path for path in sorted(root.rglob("*")) if path.is_file()
    }
    with TemporaryDirectory(dir=root.parent) as temporary:
        start = time.perf_counter()
        ran = try_out(_PREVIEW, Path(temporary), files=files, timeout_s=300)
        seconds = time.perf_counter() - start
    if ran.exit_code != 0:
        raise SystemExit(ran.log)
    return {
        "seconds": seconds,
        "previews": len(ran.report.previews),
        "size": sum((root / path).stat().st_size for path in files),
    }


if __name__ == "__main__":
    main([make_preview])
