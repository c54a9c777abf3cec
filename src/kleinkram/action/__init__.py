"""For code inside of an action: what it was given, and how it says what it found.

```python
from kleinkram.action import inputs, out, progress, report

for number, path in enumerate(inputs()):
    progress(number / len(inputs()), path.name)
    report.metric("size", path.stat().st_size, unit="B", file=path)
(out / "notes.txt").write_text("an artifact")
```

Everything goes through files: there is no connection to anything, and nothing to close. See the page on actions.
"""

from kleinkram.action.given import context, inputs, parameters
from kleinkram.action.places import out, scratch
from kleinkram.action.saying import progress, report

__all__ = ["context", "inputs", "out", "parameters", "progress", "report", "scratch"]
