"""Many independent jobs in processes of this machine or on a Dask cluster.

- ``jobs``: the jobs with their keys and results, the choice of workers, and the loop that runs the jobs
- ``cluster``: the Dask client: worker processes of this machine, or a scheduler by address
"""
