"""What the JSON of `make bench` says beside the times: versions of what was timed, the kernels, the commit."""

from torchmesh.bench.provenance import provenance


def pytest_benchmark_update_json(config, benchmarks, output_json):
    output_json["torchmesh"] = provenance()
