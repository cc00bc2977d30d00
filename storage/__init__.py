"""The ground: arrays, bytes, time and cameras as data. Knows neither stages nor dags nor Dask."""
