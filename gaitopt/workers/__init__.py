"""Independent jobs on the processes of this machine or on a Dask cluster."""
