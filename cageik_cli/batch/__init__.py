"""Many clips, in processes of this machine or on a Dask cluster; one report over all."""
