"""Reads an exported table with readers that share no code with Lacuna and prints its columns as JSON.

    read_table.py FILE.csv        pandas
    read_table.py FILE.parquet    pyarrow
    read_table.py FILE.mat        scipy.io.loadmat

Output: {"columns": {name: [values]}, "units": {group: unit}, "joints": {group: [names]}}. Numbers are strings that hold
all digits; a missing one is null. The columns of a matrix in a MAT-file are named as in the other formats.
"""

import json
import math
import sys


def plain(value):
    if value is None:
        return None
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, bool):
        return value
    if isinstance(value, float):
        return None if math.isnan(value) else repr(value)
    return value


def csv(path):
    import pandas as pd

    table = pd.read_csv(path, float_precision="round_trip")
    return {"columns": {name: [plain(v) for v in table[name]] for name in table.columns}, "units": {}, "joints": {}}


def parquet(path):
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path)
    table = file.read()
    columns = {name: [plain(v) for v in table.column(name).to_pylist()] for name in table.schema.names}
    about = json.loads(file.schema_arrow.metadata[b"lacuna.columns"])
    if [c["name"] for c in about] != table.schema.names[2:]:
        sys.exit("the metadata names other columns than the file has")
    joints = {}
    for c in about:
        joints.setdefault(c["group"], []).append(c["joint"])
    types = {f.name: str(f.type) for f in table.schema}
    return {"columns": columns, "units": {c["group"]: c["unit"] for c in about}, "joints": joints, "types": types}


def mat(path):
    from scipy.io import loadmat

    found = loadmat(path)
    text = lambda a: "" if a.size == 0 else str(a.ravel()[0])
    units = {name: text(found["units"][name][0, 0]) for name in found["units"].dtype.names}
    joints = {
        name: [text(c) for c in found["joints"][name][0, 0].ravel()] for name in found["joints"].dtype.names
    }
    columns = {name: [plain(v) for v in found[name][:, 0]] for name in ["t_s", "stamp_ns"]}
    for group, names in joints.items():
        for i, joint in enumerate(names):
            name = f"{group}_{joint}" if joint else group
            columns[name] = [plain(v) for v in found[group][:, i]]
    return {"columns": columns, "units": units, "joints": joints}


READERS = {"csv": csv, "parquet": parquet, "mat": mat}

if __name__ == "__main__":
    json.dump(READERS[sys.argv[1].rsplit(".", 1)[-1]](sys.argv[1]), sys.stdout)
