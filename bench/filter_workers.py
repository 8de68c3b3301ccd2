#!/usr/bin/python3
"""How soon the last picture of a large frame is there when workers help to filter it.

  bench/filter_workers.py --build build/release [--workers 0 1 2] [--size 1920x1080]

For each number of helping workers: a server, as many workers of one thread (at least one, to
render), and one job whose last picture is filtered by the server alone (0) or by all. Prints the
seconds from the last sample to the picture, processor time by place, bytes both ways, and whether
the picture is the same to the last bit; exit code 1 if not. The server filters on --filter-threads
threads (1): on a machine with fewer cores than threads the processes take each other's time.
"""

import argparse
import hashlib
import os
import pathlib
import re
import sys
import tempfile

from farm_faults import Farm, client


def picture_hash(farm: Farm, job: int, folder: pathlib.Path) -> str:
    output = folder / "picture.exr"
    fetched = client(farm.programs, "fetch", f"jobs/{job}", "-o", output, "--layers", "all",
                     "--server", f"127.0.0.1:{farm.port}", "--json")
    if "failed" in fetched:
        raise SystemExit(f"fetching failed: {fetched['error']}")
    # All but when it was written: an EXR attribute of type string, its size and 19 characters.
    written = re.sub(rb"capDate\0string\0....[0-9: ]{19}", b"", output.read_bytes(), flags=re.S)
    return hashlib.sha256(written).hexdigest()[:16]


def measure(arguments, helpers: int, folder: pathlib.Path) -> dict:
    programs = pathlib.Path(arguments.build) / "bin"
    farm = Farm(programs, folder, server_options=[
        "--filter-on", arguments.filter_on if helpers else "server",
        "--filter-threads", arguments.filter_threads])
    try:
        farm.start_server()
        for i in range(max(1, helpers)):
            farm.start_worker(f"worker{i}")
        done = client(programs, "render", arguments.scene, "--size", arguments.size, "--spp",
                      arguments.spp, "--seed", 3, "-o", folder / "out.exr", "--json", "--quiet",
                      "--server", f"127.0.0.1:{farm.port}", "--insecure")
        if "failed" in done:
            raise SystemExit(f"the job failed: {done['error']}")
        return {
            "helpers": helpers,
            "filter_s": done["seconds"]["filter"],
            "server_cpu_s": farm.metric("tessera_filter_core_seconds_total"),
            "workers_cpu_s": farm.metric("tessera_worker_filter_core_seconds_total"),
            "server_px": farm.metric("tessera_filtered_pixels_total", 'on="server"'),
            "workers_px": farm.metric("tessera_filtered_pixels_total", 'on="workers"'),
            "lost": farm.metric("tessera_filter_leases_lost_total"),
            "to_workers": farm.metric("tessera_filter_bytes_total", "to_workers"),
            "from_workers": farm.metric("tessera_filter_bytes_total", "from_workers"),
            "picture": picture_hash(farm, 1, folder),
        }
    finally:
        farm.stop()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default="build/release")
    parser.add_argument("--scene", help="default: the Cornell box of the build")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--spp", default=4, type=int)
    parser.add_argument("--workers", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--filter-threads", default=1, type=int)
    parser.add_argument("--filter-on", default="auto", choices=["auto", "workers"])
    arguments = parser.parse_args()
    arguments.scene = arguments.scene or f"{arguments.build}/scenes/cornell.glb"
    rows = []
    print(f"{arguments.size}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, server filters "
          f"on {arguments.filter_threads} thread(s)")
    print(f"{'helpers':>7} {'filter s':>9} {'server CPU':>10} {'workers CPU':>11} {'workers px':>10} "
          f"{'lost':>4} {'MB there':>8} {'MB back':>7}  picture")
    for helpers in arguments.workers:
        with tempfile.TemporaryDirectory() as folder:
            row = measure(arguments, helpers, pathlib.Path(folder))
        rows.append(row)
        share = row["workers_px"] / max(1, row["workers_px"] + row["server_px"])
        print(f"{helpers:7d} {row['filter_s']:9.2f} {row['server_cpu_s']:10.2f} "
              f"{row['workers_cpu_s']:11.2f} {share:10.0%} {row['lost']:4.0f} "
              f"{row['to_workers'] / 1e6:8.1f} {row['from_workers'] / 1e6:7.1f}  {row['picture']}",
              flush=True)
    return 0 if len({row["picture"] for row in rows}) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
