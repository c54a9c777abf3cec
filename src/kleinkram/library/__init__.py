"""The actions that are shipped: each script beside this file is one, of the version of the package.

A script describes itself in its header (PEP 723) and runs where its `dependencies` are installed. The rest of Kleinkram
never imports a script, and none of the packages that one needs. `inputs` is what the scripts share.
"""
