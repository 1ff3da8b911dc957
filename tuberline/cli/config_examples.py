"""An example of each key of a line's file whose default is none: what a user would write behind the `=`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

EXAMPLES: Mapping[str, Any] = {
    "name": "north",
    "link.listen": ["tls/0.0.0.0:7447"],
    "link.root_ca": "certs/ca.pem",
    "link.certificate": "certs/segmenter.pem",
    "link.private_key": "certs/segmenter.key",
    "link.certs": "certs",
    "access.regressors": ["r1", "r2"],
    "access.encoders": ["encoder"],
    "access.gnss": ["receiver"],
    "cameras.<camera>.path": "recordings/monday",
    "cameras.<camera>.camera": "left",
    "cameras.<camera>.starts_at_s": 1795000000.0,
    "cameras.<camera>.serial": "218622270973",
    "cameras.<camera>.topic": "/camera/camera/depth/image_rect_raw",
    "cameras.<camera>.info_topic": "/camera/camera/depth/camera_info",
    "cameras.<camera>.ros_router": "tcp/10.0.0.7:7447",
    "cameras.<camera>.belt_distance_m": 0.46,
    "cameras.<camera>.across_m": 0.297,
    "cameras.<camera>.along_m": 0.06,
    "cameras.<camera>.turned_deg": 180.0,
    "cameras.<camera>.belt_from_camera": [[0, 1, 0, 0], [1, 0, 0, 0.297], [0, 0, -1, 0.46], [0, 0, 0, 1]],
    "cameras.<camera>.depth_scale_m": 0.0001,
    "cameras.<camera>.realsense.exposure_us": 4000,
    "cameras.<camera>.realsense.gain": 16,
    "cameras.<camera>.realsense.preset": "high-accuracy",
    "cameras.<camera>.realsense.laser": False,
    "cameras.<camera>.realsense.laser_mw": 150,
    "cameras.<camera>.realsense.filters": ["spatial"],
    "belt.gauge_width_m": 0.8,
    "belt.gauge_size_mm": [40.0, 30.0],
    "belt.gauge_place_mm": [0.0, -420.0, 100.0],
    "belt.resting_sd_mm": 1.5,
    "segmenter.weights": "my-belt.onnx",
    "segmenter.state_dir": "/var/lib/tuberline/segmenter",
    "regressor.weights": "my-crop.safetensors",
    "regressor.centroids": 16,
    "regressor.state_dir": "/var/lib/tuberline/regressor",
    "aggregator.out": "runs/monday",
    "aggregator.tickets": "tickets.json",
    "aggregator.contract": "contract.toml",
    "aggregator.cultivar": "Fontane",
    "viewer.rrd": "load.rrd",
    "viewer.connect": "rerun+http://127.0.0.1:9876/proxy",
    "viewer.foxglove": "127.0.0.1:8765",
    "alarms.channels": ["https://farm.example/alarms"],
    "alarms.channels_file": "alarm-channels.txt",
    "alarms.root_ca": "certs/farm-ca.pem",
    "alarms.state_dir": "/var/lib/tuberline/alarms",
    "gnss.source": "serial:/dev/ttyACM0?baud=9600",
    "gnss.delay_s": 9.5,
    "encoder.source": "serial:/dev/ttyACM0?baud=115200",
    "encoder.metres_per_pulse": 0.0005,
}


def example(key: str, value: Mapping[str, Any], default: Any) -> str:
    """TOML of a value that `key` may have; `value`: what the schema says of it. The default's opposite for a switch,
    another choice where there are some, else the default where nothing better is known.
    """
    if key in EXAMPLES:
        return json.dumps(EXAMPLES[key])
    if isinstance(default, bool):
        return json.dumps(not default)
    others = [choice for choice in value.get("enum", ()) if choice != default]
    return json.dumps(others[0] if others else default)
