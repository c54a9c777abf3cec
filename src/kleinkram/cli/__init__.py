"""The command `klein`: one module per resource; parse, one SDK call, render. No logic, no HTTP."""
