"""What is read off error curves: equivalent samples, the winner at a time, the Pareto front."""

import math


def interpolate(xs: list[float], ys: list[float], x: float) -> tuple[float, bool] | None:
    """y at x, straight in log-log; the flag says that x lies beyond the last point.

    Beyond the last point the last two points' line goes on, up to four times its x, but it neither
    rises nor falls faster than 1 / x. None below the first point, beyond that, or where a needed y
    is not positive.
    """
    points = sorted((a, b) for a, b in zip(xs, ys) if a > 0 and b > 0)
    if not points or x < points[0][0] or x > 4 * points[-1][0]:
        return None
    if len(points) == 1:
        return (points[0][1], False) if x == points[0][0] else None
    beyond = x > points[-1][0]
    for (x0, y0), (x1, y1) in zip(points, points[1:]):
        if x0 <= x <= x1 or (beyond and (x1, y1) == points[-1]):
            if x1 == x0:
                return min(y0, y1), beyond
            slope = math.log(y1 / y0) / math.log(x1 / x0)
            if beyond:
                # Two points with noise may say anything; samples do not gain more than 1 / x.
                slope = min(0.0, max(-1.0, slope))
                x0, y0 = x1, y1
            return y0 * (x / x0) ** slope, beyond
    return None


def fitted_power(counts: list[float], errors: list[float]) -> tuple[float, float] | None:
    """(a, b) of errors = a counts^-b by least squares in log-log; None with under two points."""
    points = [(math.log(n), math.log(e)) for n, e in zip(counts, errors) if n > 0 and e > 0]
    if len(points) < 2:
        return None
    mean_x = sum(x for x, _ in points) / len(points)
    mean_y = sum(y for _, y in points) / len(points)
    spread = sum((x - mean_x) ** 2 for x, _ in points)
    if spread == 0:
        return None
    slope = sum((x - mean_x) * (y - mean_y) for x, y in points) / spread
    return math.exp(mean_y - slope * mean_x), -slope


def multiplier(raw_counts: list[float], raw_errors: list[float], count: float,
               error: float) -> float | None:
    """How many times `count` raw samples have `error`, by raw's fitted curve; None if unknown."""
    fit = fitted_power(raw_counts, raw_errors)
    if fit is None or error <= 0 or fit[1] <= 0:
        return None
    return (fit[0] / error) ** (1 / fit[1]) / count


def pareto_front(points: list[tuple[float, float]]) -> list[int]:
    """Indices, by ascending cost, of the (cost, error) that no other beats in both."""
    front, best = [], math.inf
    for i in sorted(range(len(points)), key=lambda i: points[i]):
        if points[i][1] < best:
            best = points[i][1]
            front.append(i)
    return front


def winner(curves: dict[str, tuple[list[float], list[float]]], cost: float):
    """(name, error, beyond, name of the second, its error) at `cost`, or None.

    `curves` maps a method to its costs and errors. The second is None where only one is known.
    """
    ranked = []
    for name, (costs, errors) in curves.items():
        found = interpolate(costs, errors, cost)
        if found:
            ranked.append((found[0], name, found[1]))
    if not ranked:
        return None
    ranked.sort()
    second = ranked[1] if len(ranked) > 1 else (None, None, None)
    return ranked[0][1], ranked[0][0], ranked[0][2], second[1], second[0]
