#!/usr/bin/env python3
"""A Rerun blueprint for Lacuna's recordings, whatever joints the robot has (needs `pip install rerun-sdk`).

    rerun_blueprint.py lacuna.rbl && rerun run.mcap lacuna.rbl
    rerun_blueprint.py --list          the entities it shows, one a line
"""

import sys

VIEWS = {
    "Torque": {
        "Torque measured [Nm]": ["/measured/effort"],
        "Torque of the rigid body [Nm]": ["/torque/rigid/effort"],
        "Friction [Nm]": ["/friction/effort"],
        "Residual: measured less model [Nm]": ["/residual/effort"],
    },
    "Motion": {
        "Position [rad]": ["/smoothed/position"],
        "Velocity [rad/s]": ["/smoothed/velocity"],
        "Residual after the payload [Nm]": ["/residual_payload/effort"],
    },
}


def main():
    if sys.argv[1:] == ["--list"]:
        print("\n".join(path for tab in VIEWS.values() for paths in tab.values() for path in paths))
        return
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    import rerun.blueprint as rrb

    tabs = [
        rrb.Vertical(*[rrb.TimeSeriesView(origin="/", contents=paths, name=name) for name, paths in views.items()], name=tab)
        for tab, views in VIEWS.items()
    ]
    rrb.Blueprint(rrb.Tabs(*tabs), collapse_panels=True).save("lacuna", sys.argv[1])


if __name__ == "__main__":
    main()
