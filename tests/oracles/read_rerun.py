"""Reads a recording as the Rerun viewer does, which shares no code with Lacuna.

    read_rerun.py read FILE.mcap            series by entity path: joint names, numbers, stamps, as JSON
    read_rerun.py picture FILE.mcap PNG     the viewer itself, without a window: position, torque and residual over time
                                            (exits with 3 where there is no graphics driver, e.g. Mesa's lavapipe)
"""

import json
import socket
import sys
import time


def read(path):
    from rerun.chunk import McapReader

    found = {}
    for chunk in McapReader(path).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        if "Scalars:scalars" not in names or "SeriesLines:names" not in names:
            continue
        entry = found.setdefault(str(chunk.entity_path), {"names": [], "values": [], "stamp": []})
        column = lambda name: batch.column(names.index(name))
        for joints in column("SeriesLines:names").to_pylist():
            if joints not in entry["names"]:
                entry["names"].append(joints)
        entry["values"] += [[repr(v) for v in row] for row in column("Scalars:scalars").to_pylist()]
        entry["stamp"] += column("ros2_timestamp").cast("int64").to_pylist()
    for entry in found.values():
        order = sorted(range(len(entry["stamp"])), key=lambda i: entry["stamp"][i])
        entry["stamp"] = [entry["stamp"][i] for i in order]
        entry["values"] = [entry["values"][i] for i in order]
    json.dump(found, sys.stdout)


def picture(path, png):
    import os

    import rerun as rr
    import rerun.blueprint as rrb
    from rerun.experimental import ViewerClient

    view = lambda origin, name: rrb.TimeSeriesView(origin=origin, name=name)
    views = [
        view("/measured/position", "position [rad]"),
        view("/measured/effort", "torque [Nm]"),
        view("/residual/effort", "residual [Nm]"),
    ]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    beside = os.path.join(os.path.dirname(sys.executable), "rerun")
    try:
        client = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=beside)
    except Exception as e:
        print(f"no viewer: {e}", file=sys.stderr)
        sys.exit(3)
    recording = rr.RecordingStream("lacuna")
    try:
        recording.connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy")
        recording.send_blueprint(rrb.Blueprint(rrb.Vertical(*views), collapse_panels=True))
        recording.log_file_from_path(path)
        recording.flush()
        # The viewer says when it has all of it.
        until = time.time() + 120
        last = None
        while time.time() < until:
            state = client.get_state()
            ends = [t.end for r in state.recordings for t in r.timelines]
            if ends and ends == last and not state.loading:
                break
            last = ends
            time.sleep(2)
        reports = [report for v in client.get_state().views for report in v.reports]
        client.save_screenshot(png)
        print(json.dumps({"views": [v.origin for v in client.get_state().views], "reports": [str(r) for r in reports]}))
    finally:
        recording.disconnect()
        client.quit()


if __name__ == "__main__":
    if sys.argv[1] == "read":
        read(sys.argv[2])
    else:
        picture(sys.argv[2], sys.argv[3])
