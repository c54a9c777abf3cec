"""Scripts of actions for runs on clusters, fake and real."""

COPY = (
    "from kleinkram.action import inputs, out, report, context\n"
    "report.metric('size', 3, unit='B')\n"
    "(out / 'deep').mkdir()\n"
    "(out / 'deep' / 'copy').write_bytes((out.parent / 'in' / 'a' / 'drive.bag').read_bytes())\n"
    "print(context().mission.name)\n"
)
# Runs until there is a file `end` among its results.
LASTING = (
    "import pathlib, time\n"
    "from kleinkram.action import out\n"
    "print('began', flush=True)\n"
    "while not pathlib.Path('/out/end').exists(): time.sleep(0.05)\n"
    "(out / 'end').unlink(); (out / 'x').write_text('x')\n"
)
# Ends well after SIGTERM, with part of its results.
OBEDIENT = (
    "import signal, sys, time\n"
    "from kleinkram.action import out\n"
    "signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))\n"
    "(out / 'half').write_text('x')\n"
    "print('began', flush=True)\n"
    "time.sleep(60)\n"
)
