"""Makes the table of many maps that ``lightdome catalog`` writes, on a Dask cluster. Needs the extra ``[cluster]``."""
