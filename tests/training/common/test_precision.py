import pytest
import torch

from training.common.precision import full_precision, mixed_precision

CPU = torch.device("cpu")


def product() -> torch.dtype:
    return (torch.ones(2, 2) @ torch.ones(2, 2)).dtype


@pytest.mark.parametrize(("capability", "dtype"), [("AVX512", "bfloat16"), ("AVX2", "float32")])
def test_only_processors_made_for_it_compute_in_bfloat16(monkeypatch, capability, dtype):
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    with mixed_precision(CPU):
        assert product() == getattr(torch, dtype)
        with full_precision(CPU):
            assert product() == torch.float32
    assert product() == torch.float32
