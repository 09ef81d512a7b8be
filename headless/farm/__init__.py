"""Work for more machines than one, by Dask distributed: frames, tiles of a still, lightmaps.

`parts` cuts a job, `job` hands the parts out and puts the results together, `worker` is what runs on the machines.
"""
