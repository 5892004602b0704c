"""What is measured: run a part as `python -m bench.NAME`, in the folder of the repository."""
