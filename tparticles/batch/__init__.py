"""Many films unattended: sweeps and batches, on this machine or on a Dask cluster.

`grammar` reads what a sweep asks for, `tasks` and `jobs_file` make tasks of it, `record` keeps batch.json, `runner` drives a
pool of processes (`local`, `cluster`), each of which renders one film (`worker`); `gallery` shows what came of it.
"""
