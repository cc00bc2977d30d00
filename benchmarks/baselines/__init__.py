"""Plain, slow versions to compare with: in time by the benchmarks, in result by the tests."""
