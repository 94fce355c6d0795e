# SPDX-License-Identifier: Apache-2.0
"""inertiactl as a server: one command's arguments as a JSON line in, its exit code and output as a JSON line out.

Starting Python costs more than most commands. Run with PYTHONPATH at the package to be judged.
"""

import contextlib
import io
import json
import sys
import traceback

from inertiad.__main__ import main


def run(arguments: list[str]) -> dict[str, object]:
    """One command, as the shell would run it."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    sys.argv = ["inertiactl", *arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except BaseException:  # what the shell would show as a traceback is a result, too
            traceback.print_exc()
            code = 1
    return {"code": code, "out": out.getvalue(), "err": err.getvalue()}


if __name__ == "__main__":
    answers = sys.stdout
    for line in sys.stdin:
        answers.write(json.dumps(run(json.loads(line))) + "\n")
        answers.flush()
