"""What goes into docs/: whole or not at all, and what is said about sampling error."""

import math
import pathlib
import tempfile
import unittest

from charts import pages, runs, sweeps


class Pages(unittest.TestCase):
    def test_only_the_part_changes(self):
        page = "a\n<!-- begin x -->\nold\n<!-- end x -->\nb\n"
        self.assertEqual(pages.with_part(page, "x", "new\n"),
                         "a\n<!-- begin x -->\nnew\n<!-- end x -->\nb\n")
        with self.assertRaises(ValueError):
            pages.with_part(page, "y", "new")

    def test_nothing_is_published_if_a_part_is_missing(self):
        with tempfile.TemporaryDirectory() as folder:
            docs = pathlib.Path(folder) / "docs"
            (docs / "charts").mkdir(parents=True)
            (docs / "page.md").write_text("<!-- begin x -->\n<!-- end x -->\n", encoding="utf-8")
            run = runs.Run.__new__(runs.Run)
            run.docs, run.out, run.made = docs, docs / "charts", docs / "made"
            run.made.mkdir()
            (run.made / "new.svg").write_text("new", encoding="utf-8")
            run._parts = [("page.md", "x", "text"), ("page.md", "y", "text")]
            with self.assertRaises(ValueError):
                run.publish()
            self.assertEqual(list(run.out.iterdir()), [])
            self.assertNotIn("text", (docs / "page.md").read_text(encoding="utf-8"))
            run._parts.pop()
            run.publish()
            self.assertEqual([p.name for p in run.out.iterdir()], ["new.svg"])
            self.assertIn("text", (docs / "page.md").read_text(encoding="utf-8"))


class SamplingError(unittest.TestCase):
    def test_of_a_mean(self):
        mean, error = sweeps.mean_and_error([1.0, 3.0])
        self.assertAlmostEqual(mean, 2)
        self.assertAlmostEqual(error, 1)
        self.assertEqual(sweeps.mean_and_error([1.0])[1], math.inf)

    def test_every_failure_has_a_severity_to_sweep(self):
        for name, failure in sweeps.FAILURES.items():
            self.assertGreaterEqual(len(failure.values), 4, name)
            self.assertEqual(len(set(failure.values)), len(failure.values), name)


if __name__ == "__main__":
    unittest.main()
