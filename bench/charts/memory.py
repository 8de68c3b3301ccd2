"""Peak memory of filtering, by filter and size of the frame."""

from tessera_chart.store import Store

SIZES = ("320x180", "640x360", "1280x720")


def measure(tessera, scene, store: Store, quick: bool) -> list[dict]:
    """Resident memory of `tessera denoise` at its greatest: the film that it reads, the picture, and
    what the filter needs."""
    rows = []
    for size in ("64x36",) if quick else SIZES:
        width, height = map(int, size.split("x"))
        film = store.path(f"memory.{size}.film.exr")
        filters = [entry["name"] for entry in tessera.denoisers()]
        for name in filters[:1] if quick else filters:
            key = f"memory.{size}.{name}"
            found = store.get(key)
            if found is None:
                if not film.is_file():
                    part = film.with_suffix(".part.exr")
                    tessera.run("render", scene, "-o", part, "--size", size, "--spp", 2,
                                "--denoiser", "none", "--layers", "film", "--quiet")
                    part.rename(film)
                peak = tessera.peak_bytes("denoise", film, "-o", store.path("memory.exr"),
                                          "--layers", "final", "--denoiser", name)
                found = {"peak_bytes": peak}
                store.put(key, found)
            rows.append({"quantity": "memory", "x": width * height, "method": name, **found})
        film.unlink(missing_ok=True)
    return rows
