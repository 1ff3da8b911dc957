"""`tuberline`: one command per job. Commands live in their packages and are imported when they run: help stays quick.

This package is the composition root, the only place that knows the other packages.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from types import FrameType

from cyclopts import App, Group

from conveyor import __version__
from conveyor.errors import TuberlineError

_GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "Main jobs": {
        "demo": ("tuberline.cli.demo:demo", "Simulate a belt, run the whole line on it, compare with the truth."),
        "replay": ("tuberline.replay:replay", "Run the whole line on a recording: ledger, summary, tubers."),
        "run": ("tuberline.cli.run:run", "Run all processes of a line on this machine, supervised."),
        "weigh": ("tuberline.cli.model:weigh", "Weigh single clouds or depth and mask pairs; no network."),
        "score": ("tuberline.cli.ledger:score", "Compare a run with the truth: count, weights, total."),
        "simulate": ("tuberline.cli.recordings:simulate", "Make a recording of a belt with known truth."),
    },
    "Watch a line": {
        "status": ("tuberline.cli.status:status", "Totals and nodes of a running line, once."),
        "top": ("tuberline.cli.top:top", "The same, live."),
        "health": ("tuberline.cli.doctor:health", "Is the router, or one node, well? For probes."),
        "metrics": ("tuberline.cli.metrics:metrics", "Serve a line's counters and totals to Prometheus."),
        "graph": ("tuberline.cli.graph:graph", "Who runs where and sends what to whom, live."),
        "watch": ("tuberline.cli.viewer:watch", "Watch a running line: Rerun's window or a web page."),
        "page": ("tuberline.cli.page:page", "The operator's page: load, belt, cameras, alarms, in a browser."),
        "audit": ("tuberline.cli.ledger:audit", "The balance sheet of a run: nothing lost silently."),
        "ledger": ("tuberline.cli.ledger:ledger", "Check, repair or export a ledger."),
    },
    "Nodes of a line": {
        "router": ("tuberline.cli.router:router", "The Zenoh router of a line."),
        "camera": ("tuberline.cli.recordings:camera", "Publish the frames of one camera."),
        "segmenter": ("tuberline.cli.segmentation:segmenter", "Find and follow tubers in one camera's frames."),
        "regressor": ("tuberline.cli.model:regressor", "Weigh views; any number, anywhere."),
        "aggregator": ("tuberline.cli.ledger:aggregator", "Count tubers once and keep the ledger."),
        "viewer": ("tuberline.cli.viewer:viewer", "Show the line in Rerun: a file or a live hub."),
        "recorder": ("tuberline.cli.recordings:recorder", "Record a line's frames to MCAP."),
    },
    "Recordings": {
        "info": ("tuberline.cli.recordings:info", "Describe a recording and warn of its traps."),
        "convert": ("tuberline.cli.recordings:convert", "Convert a recording, lossless."),
        "recover": ("tuberline.cli.recordings:recover", "Mend an MCAP file whose writer was killed."),
        "simulate-views": (
            "tuberline.cli.recordings:simulate_views",
            "Make single views with known weights, for training.",
        ),
        "simulate-belts": (
            "tuberline.cli.simulate_belts:simulate_belts",
            "Make labelled frames of belts, for train-eyes.",
        ),
        "segment": ("tuberline.cli.segmentation:segment", "Segment a recording and draw what was found."),
        "evaluate-segmentation": (
            "tuberline.cli.segmentation:evaluate_segmentation",
            "Score masks against a recording's own.",
        ),
    },
    "Model": {
        "train": ("tuberline.cli.model:train", "Train PointRAFT."),
        "cut-portraits": (
            "tuberline.cli.train_classifier:cut_portraits",
            "Cut belts into what train-eyes learns from.",
        ),
        "train-eyes": (
            "tuberline.cli.train_classifier:train_eyes",
            "Train the segmenter's network to tell clods from tubers.",
        ),
        "evaluate": ("tuberline.cli.model:evaluate", "Evaluate weights and baselines on views with known weights."),
        "ablate": ("tuberline.cli.studies:ablate", "Train or load the paper's ablations and compare them."),
        "search": ("tuberline.cli.studies:search", "Search for a recipe with Optuna."),
        "split": ("tuberline.cli.studies:split", "Share tubers out over training, validation and test."),
        "drift": ("tuberline.cli.studies:drift", "Evaluate weights on views that drift from their training."),
        "calibrate-blend": ("tuberline.cli.studies:calibrate_blend", "Fit volume rule and blend of saved weights."),
        "calibrate-interval": ("tuberline.cli.studies:calibrate_interval", "Calibrate saved weights' intervals."),
        "evaluation-page": ("tuberline.cli.studies:evaluation_page", "Make the page of results from saved ones."),
        "export": ("tuberline.cli.model:export", "Export the network to ONNX."),
        "weights": ("tuberline.cli.weights:weights", "The weights of a running line: list, change, go back."),
        "import-checkpoint": ("tuberline.cli.model:import_checkpoint", "Take over the authors' checkpoint."),
    },
    "Set up": {
        "calibrate": ("tuberline.cli.calibrate:calibrate", "Measure the geometry of a line."),
        "config": ("tuberline.cli.config:config", "Check, show or explain a line's configuration."),
        "topics": ("tuberline.cli.topics:topics", "The table of topics."),
        "certs": ("tuberline.cli.certs:certs", "A site's own certificates, one per node."),
        "access": ("tuberline.cli.access:access", "Who may do what: the router's rules, from the table of topics."),
        "doctor": ("tuberline.cli.doctor:doctor", "What is wrong with a line or this machine, and how to mend it."),
        "bundle": ("tuberline.cli.doctor:bundle", "Pack what a helper needs to see; no private keys."),
    },
}


def build_app() -> App:
    """The command tree, with nothing imported yet."""
    app = App(
        name="tuberline",
        help="Counts and weighs every potato on a harvester's conveyor, from depth cameras.",
        version=__version__,
        help_on_error=False,
    )
    for order, (title, commands) in enumerate(_GROUPS.items()):
        group = Group(title, sort_key=order)
        for name, (target, about) in commands.items():
            app.command(target, name=name, help=about, group=group)
    return app


def main() -> None:
    """Entry point: a TuberlineError's text goes to stderr, its exit code to the shell; bugs keep their traceback."""
    from conveyor.logs import setup_logs
    from tuberline.orphan import watch_supervisor

    setup_logs()
    signal.signal(signal.SIGTERM, _leave)
    watch_supervisor()
    code = _run()
    if "zenoh" in sys.modules:
        # The interpreter's goodbye can wait for ever for a Zenoh thread that wants to call back into it.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _leave(number: int, _frame: FrameType | None) -> None:
    """Leave by an exception, so that a command stops the processes it started; nodes have handlers of their own."""
    raise SystemExit(128 + number)


def _run() -> int:
    """Run the command line; returns the exit code."""
    try:
        build_app()()
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else int(done.code is not None)
    except TuberlineError as error:
        sys.stderr.write(f"tuberline: {error}\n")
        return error.exit_code
    except BrokenPipeError:
        return 1
    except KeyboardInterrupt:
        return 130
    except Exception:
        traceback.print_exc()
        return 1
    return 0


if __name__ == "__main__":
    main()
