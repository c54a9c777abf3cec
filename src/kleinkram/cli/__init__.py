"""The command `klein`: one module a noun; parse, one SDK call, render. No logic, no HTTP."""
