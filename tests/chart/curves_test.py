"""What is read off curves, by hand; the search for the best options."""

import unittest

import numpy

from tessera_chart import curves, ladder, measures, methods, results


class Curves(unittest.TestCase):
    def test_interpolates_straight_in_log_log(self):
        error, beyond = curves.interpolate([1, 100], [1, 0.01], 10)
        self.assertAlmostEqual(error, 0.1)
        self.assertFalse(beyond)

    def test_goes_on_beyond_the_last_point_but_not_far(self):
        error, beyond = curves.interpolate([1, 4], [1, 0.25], 16)
        self.assertAlmostEqual(error, 1 / 16)
        self.assertTrue(beyond)
        self.assertIsNone(curves.interpolate([1, 4], [1, 0.25], 17))
        self.assertIsNone(curves.interpolate([1, 4], [1, 0.25], 0.9))

    def test_noise_does_not_make_promises_beyond_the_last_point(self):
        self.assertAlmostEqual(curves.interpolate([1, 2], [1, 1e-6], 4)[0], 0.5e-6)
        self.assertAlmostEqual(curves.interpolate([1, 2], [1e-6, 1], 4)[0], 1)

    def test_errors_within_the_noise_of_the_references_are_no_points(self):
        self.assertIsNone(curves.interpolate([1, 4], [-1, 0], 2))

    def test_multiplier_is_that_of_the_fitted_line(self):
        counts, errors = [4, 16, 64], [0.25, 0.0625, 0.015625]
        self.assertAlmostEqual(curves.multiplier(counts, errors, 4, 0.0625), 4)
        self.assertAlmostEqual(curves.multiplier(counts, errors, 64, 0.03125), 0.5)
        self.assertIsNone(curves.multiplier(counts, errors, 4, -1e-9))

    def test_front_has_what_no_other_beats_in_both(self):
        points = [(2, 2), (1, 4), (3, 3), (4, 1)]
        self.assertEqual(curves.pareto_front(points), [1, 0, 3])

    def test_winner_has_the_least_error_at_the_cost(self):
        found = curves.winner({"a": ([1, 10], [1, 0.1]), "b": ([2, 10], [0.1, 0.09])}, 5)
        self.assertEqual(found[0], "b")
        self.assertEqual(found[3], "a")


class Search(unittest.TestCase):
    def test_finds_the_best_of_a_separable_error(self):
        method = methods.Method("g-best", "g", options=(("radius", 2.0), ("depth", 0.05)),
                                searched=("radius", "depth"))
        best, tried = methods.search(
            method, lambda o: abs(o["radius"] - 8) + abs(o["depth"] - 0.2))
        self.assertEqual(best, {"radius": 8, "depth": 0.2})
        self.assertGreater(tried, 5)


class CpuTimes(unittest.TestCase):
    def test_tells_loading_and_samples_apart(self):
        load, per_spp = ladder.cpu_times([4, 16, 64], [9, 0.3 + 0.5 + 12 * 0.1, 0.3 + 0.5 + 4.8], 0.3)
        self.assertAlmostEqual(load, 0.5)
        self.assertAlmostEqual(per_spp, 0.1)

    def test_short_ladders_count_loading_with_the_samples(self):
        self.assertEqual(ladder.cpu_times([4], [1.3], 0.3), (0.0, 0.25))


class Sentences(unittest.TestCase):
    def test_say_who_wins_and_what_the_references_cannot_tell(self):
        rows = [{"scene": "s", "method": m, "spp": n, "own_spp": n, "seed": 1, "total_cpu_s": float(t),
                 "rel_mse": e} for m, errors in (("raw", (1, 1e-6)), ("f", (0.1, 0.5e-6)))
                for n, t, e in zip((4, 64), (1, 60), errors)]
        said = results.sentence("s", results.means_of(rows, "s"), uncertainty=1e-6)
        self.assertIn("at 1 s f (relMSE 0.1; next raw, 10.00 times that)", said)
        self.assertIn("at 60 s more than one within the references' noise", said)


class Frames(unittest.TestCase):
    def test_all_but_loading_is_in_proportion_to_pixels(self):
        plan = ladder.Plan(None, [], [4, 16, 64], [1], "32x18", 8, [], None, frame="64x36")
        step = {"seconds": {"load": 1.0, "render": 2.0}, "bytes": {"deltas": 10}}
        steps = [{**step, "process_cpu_s": s} for s in (0, 0.3 + 0.5 + 1.2, 0.3 + 0.5 + 4.8)]
        costs = ladder._Costs(plan, 32 * 18, steps, 0.3)
        row = costs.scaled({"method": "x", "filter_s": 1.0, "filter_cpu_s": 0.5, **costs.of_step(1)})
        self.assertAlmostEqual(row["render_cpu_s"], 0.5 + 4 * 1.6)
        self.assertAlmostEqual(row["render_s"], 1 + 4 * 4)
        self.assertAlmostEqual(row["total_cpu_s"], 0.5 + 4 * 1.6 + 4 * 0.5)
        self.assertEqual(row["bytes"], 80)


class Spectra(unittest.TestCase):
    def setUp(self):
        random = numpy.random.default_rng(1)
        self.truth = random.uniform(0.2, 1, (36, 64, 3))
        self.reference = measures.Reference(
            *(self.truth + random.normal(0, 0.01, self.truth.shape) for _ in range(2)))

    def test_power_sums_to_rel_mse(self):
        picture = self.truth * 1.1
        _, power = self.reference.power(picture)
        self.assertAlmostEqual(power.sum(), self.reference.relative_errors(picture).mean())

    def test_waves_are_blotches_from_16_pixels_on(self):
        x = numpy.arange(64)[None, :, None]
        for wavelength, is_blotch in ((32, True), (8, False)):
            scale = numpy.sqrt(self.reference.mean ** 2 + measures.RELATIVE_FLOOR)
            wave = 0.1 * numpy.sin(2 * numpy.pi * x / wavelength) * scale
            found = self.reference.errors(self.reference.mean + wave)
            share = found.blotches / found.rel_mse
            self.assertAlmostEqual(share, 1.0 if is_blotch else 0.0, delta=0.1)

    def test_bias_is_that_of_the_mean(self):
        self.assertAlmostEqual(self.reference.errors(self.reference.mean * 1.1).bias, 0.1)


class Means(unittest.TestCase):
    def test_ranges_are_those_of_the_seeds(self):
        rows = [{"scene": "s", "method": "raw", "spp": 4, "own_spp": 4, "seed": seed, "rel_mse": e}
                for seed, e in ((1, 0.1), (2, 0.3))]
        mean = results.means_of(rows, "s")["raw"][0]
        self.assertAlmostEqual(mean.values["rel_mse"], 0.2)
        self.assertEqual((mean.low["rel_mse"], mean.high["rel_mse"]), (0.1, 0.3))


if __name__ == "__main__":
    unittest.main()
