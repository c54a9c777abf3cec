"""Check the types of the Python examples in the README: `python -m tools.check_readme`, part of `make check`.

They are checked with the cache of `mypy`, which runs before.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

_README = Path(__file__).parent.parent / "README.md"


def main() -> int:
    """Run mypy on all examples; returns its exit code."""
    examples = re.findall(r"```python\n(.*?)```", _README.read_text(encoding="utf-8"), re.DOTALL)
    if not examples:
        print(f"{_README} has no Python example")  # noqa: T201
        return 1
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, f"example_{number}.py") for number in range(len(examples))]
        for file, example in zip(files, examples, strict=True):
            file.write_text(example, encoding="utf-8")
        command = [sys.executable, "-m", "mypy", "--no-error-summary", *map(str, files)]
        return subprocess.run(command, cwd=_README.parent, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
