"""For the code of an action: its inputs and parameters, and functions that report results.

```python
from kleinkram.action import inputs, out, progress, report

for number, path in enumerate(inputs()):
    progress(number / len(inputs()), path.name)
    report.metric("size", path.stat().st_size, unit="B", file=path)
(out / "notes.txt").write_text("an artifact")
```

All communication is through files: there is no connection to close. See the page on actions.
"""

from kleinkram.action.events import progress, report
from kleinkram.action.run_files import context, inputs, out, parameters, scratch

__all__ = ["context", "inputs", "out", "parameters", "progress", "report", "scratch"]
