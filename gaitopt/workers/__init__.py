"""Many independent jobs in processes of this machine or on a Dask cluster.

- ``jobs``: jobs, workers, and the loop that runs them
- ``cluster``: the Dask client: worker processes of this machine, or a scheduler by address
"""
