#!/usr/bin/env python3
"""Makes the layouts of this folder for a robot with other joints than q1, q2, q3.

    make.py --joints shoulder,elbow,wrist [--out FOLDER]

foxglove.json     Foxglove and Lichtblick: import the layout, then open a recording or ws://127.0.0.1:8765
plotjuggler.xml   PlotJuggler: load the recording, then the layout
Rerun needs no list of joints: rerun_blueprint.py.
"""

import argparse
import json
import sys
from pathlib import Path
from xml.sax.saxutils import quoteattr

COLOURS = ["#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2"]


def panels(joints):
    """Title and signals of every plot; a signal is (topic, field, index or None, label)."""
    n = range(len(joints))
    each = lambda topic, field, what: [(topic, field, i, f"{joints[i]} {what}".strip()) for i in n]
    torque = [
        (f"Torque {joints[i]} [Nm]", [
            ("/measured", "effort", i, "measured"),
            ("/torque/rigid", "effort", i, "rigid body"),
            ("/friction", "effort", i, "friction"),
        ])
        for i in n
    ]
    return {
        "Torque": torque + [("Residual: measured less model [Nm]", each("/residual", "effort", ""))],
        "Motion": [
            ("Position [rad]", each("/smoothed", "position", "")),
            ("Velocity [rad/s]", each("/smoothed", "velocity", "")),
            ("Acceleration [rad/s²]", each("/smoothed/detail", "acceleration", "")),
        ],
        "Payload and alarms": [
            # Its standard deviation is a thousand kilograms before the first motion: beside it no mass would be seen.
            ("Payload [kg]", [("/payload", "mass", None, "mass")]),
            ("Residual after the payload [Nm]", each("/residual_payload", "effort", "")),
            ("Evidence of a mismatch: an alarm from 1 on", each("/monitor", "score", "")),
            ("Alarms", each("/monitor", "alarm", "")),
            ("Samples dropped on the way", [("/status", "dropped", None, "dropped")]),
        ],
    }


def foxglove(joints):
    config, tabs = {}, []
    for tab, plots in panels(joints).items():
        ids = []
        for title, signals in plots:
            ids.append(f"Plot!lacuna{len(config)}")
            path = lambda topic, field, i: f"{topic}.{field}" + ("" if i is None else f"[{i}]")
            config[ids[-1]] = {
                "title": title,
                # Each viewer looks for its own key.
                "foxglovePanelTitle": title,
                "lichtblickPanelTitle": title,
                "paths": [
                    {
                        "value": path(topic, field, i),
                        "label": label,
                        "enabled": True,
                        "timestampMethod": "headerStamp",
                        "color": COLOURS[k % len(COLOURS)],
                    }
                    for k, (topic, field, i, label) in enumerate(signals)
                ],
                "xAxisVal": "timestamp",
                "showXAxisLabels": True,
                "showYAxisLabels": True,
                "showLegend": True,
                # Beside the curves, wide enough for names beside values of all digits.
                "legendDisplay": "left",
                "showPlotValuesInLegend": True,
                "isSynced": True,
                "sidebarDimension": 280,
            }
        tabs.append({"title": tab, "layout": stack(ids)})
    config["Tab!lacuna"] = {"activeTabIdx": 0, "tabs": tabs}
    layout = {
        "configById": config,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!lacuna",
    }
    return json.dumps(layout, indent=1, ensure_ascii=False) + "\n"


def stack(ids):
    """Panels above each other, equally high."""
    if len(ids) == 1:
        return ids[0]
    return {"direction": "column", "first": ids[0], "second": stack(ids[1:]), "splitPercentage": round(100 / len(ids), 3)}


def plotjuggler(joints):
    out = ['<?xml version="1.0" encoding="UTF-8"?>', "<root>", ' <tabbed_widget name="Main Window" parent="main_window">']
    for tab, plots in panels(joints).items():
        sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
        out += [
            f'  <Tab tab_name={quoteattr(tab)} containers="1">',
            "   <Container>",
            f'    <DockSplitter orientation="-" count="{len(plots)}" sizes="{sizes}">',
        ]
        for title, signals in plots:
            out += [
                f"     <DockArea name={quoteattr(title)}>",
                '      <plot style="Lines" mode="TimeSeries" flip_x="false" flip_y="false" line_width="1.0">',
                "       <limitY/>",
            ]
            for k, (topic, field, i, _) in enumerate(signals):
                # PlotJuggler knows the joint names of a JointState; other lists it numbers.
                if field in ("position", "velocity", "effort"):
                    name = f"{topic}/{joints[i]}/{field}"
                else:
                    name = f"{topic}/{field}" + ("" if i is None else f"[{i}]")
                out.append(f'       <curve name={quoteattr(name)} color="{COLOURS[k % len(COLOURS)]}"/>')
            out += ["      </plot>", "     </DockArea>"]
        out += ["    </DockSplitter>", "   </Container>", "  </Tab>"]
    out += ['  <currentTabIndex index="0"/>', " </tabbed_widget>", ' <use_relative_time_offset enabled="1"/>', "</root>"]
    return "\n".join(out) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", default="q1,q2,q3", help="joint names, as the robot file has them")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder to write to")
    args = parser.parse_args()
    joints = args.joints.split(",")
    if len(set(joints)) != len(joints) or not all(joints) or len(joints) > 8:
        print(f"make.py: --joints: found \"{args.joints}\"; expected 1 to 8 distinct names, with commas between them", file=sys.stderr)
        sys.exit(2)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "foxglove.json").write_text(foxglove(joints), encoding="utf-8")
    (args.out / "plotjuggler.xml").write_text(plotjuggler(joints), encoding="utf-8")


if __name__ == "__main__":
    main()
