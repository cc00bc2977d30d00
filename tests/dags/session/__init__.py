"""Tests of `posegaussian.dags.session`."""
