"""``python -m benchmarks``: all side-by-side timings, one after the other."""

from benchmarks import frf_kernel, ingest

if __name__ == "__main__":
    frf_kernel.main()
    ingest.main()
