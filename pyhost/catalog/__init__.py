"""A table of many maps, computed by a Dask cluster: ``lightdome catalog`` writes it. Needs the extra ``[cluster]``."""
