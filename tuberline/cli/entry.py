"""A command line from its first word to the exit code."""

from __future__ import annotations

import gc
import logging
import os
import sys
import traceback
from contextlib import suppress

from conveyor.crash import end_on_faults
from conveyor.errors import FAULT, PERMANENT, TuberlineError
from conveyor.files import told
from conveyor.logs import flush_outputs, say, setup_logs
from tuberline.cli.commands import LONG_RUNNING, build_app, with_own_words
from tuberline.cli.leaving import leave_when_told, swallowed, told_to_end
from tuberline.cli.streams import ReaderLeft, keep_standard_streams, outlive_readers
from tuberline.cli.width import least_width

NEW_OBJECTS = 20_000
"""So many are made before unused ones are looked for among them. Modules make up to 400,000 that stay: at Python's 700
a tenth of a regressor's start is spent on looking at those."""

MACHINE_FAULT = 1
"""Exit code where the machine failed: a disk, a port. Another try may do better, so a supervisor makes one."""


def enter() -> None:
    """Run the command line and leave: a fault of input or machine becomes one sentence and an exit code; bugs keep
    their traceback.
    """
    from tuberline.orphan import watch_supervisor

    keep_standard_streams()
    outlive_readers(sys.argv[1:])
    gc.set_threshold(NEW_OBJECTS)
    setup_logs()
    least_width()
    if sys.argv[1:2] and sys.argv[1] in LONG_RUNNING:
        end_on_faults()
    leave_when_told()
    watch_supervisor()
    code = _flushed(_run())
    if "zenoh" in sys.modules:
        logging.shutdown()
        # The interpreter's goodbye can wait forever for a Zenoh thread that wants to call back into it.
        os._exit(code)
    sys.exit(code)


def _run() -> int:
    """Run the command line; returns the exit code."""
    try:
        with_own_words(build_app(), sys.argv[1:])()
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else int(done.code is not None)
    except TuberlineError as error:
        if (code := swallowed(error)) is not None:
            return code
        say(f"tuberline: {error}\n")
        return error.exit_code
    except OSError as error:
        say(f"tuberline: {told(error, 'the output')}\n")
        logging.getLogger("tuberline").debug("where it happened", exc_info=True)
        return MACHINE_FAULT
    except KeyboardInterrupt:
        return 130
    except ModuleNotFoundError as error:
        if error.name != "torch":
            say(traceback.format_exc())
            return FAULT
        command = " ".join(sys.argv[1:2])
        say(
            f"tuberline: `{command}` needs torch for this, which is not installed here (an edge host has none): run it "
            "where torch is, in the image tuberline, or install it there: pip install torch\n"
        )
        return PERMANENT
    except Exception as error:
        if (code := told_to_end(error) or swallowed(error)) is not None:
            logging.getLogger("tuberline").debug("where it happened", exc_info=True)
            return code
        say(traceback.format_exc())
        return FAULT
    return 0


def _flushed(code: int) -> int:
    """What is left of the output goes out now, where a full disk can still be told; returns the exit code."""
    try:
        with suppress(ReaderLeft):  # the command is over, and has its own code
            sys.stdout.flush()
    except OSError as error:
        say(f"tuberline: {told(error, 'the standard output')}\n")
        # The interpreter would try again on its way out, and complain in words of its own.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = code or MACHINE_FAULT
    flush_outputs()
    return code
