"""``python -m benchmarks``: all side-by-side timings, one after the other."""

from benchmarks import extended, frf_kernel, generator, identification, ingest, receptance, transmission_line

if __name__ == "__main__":
    for benchmark in (frf_kernel, receptance, transmission_line, extended, generator, identification, ingest):
        benchmark.main()
