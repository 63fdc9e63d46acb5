# The training, with torch for processors; data sets and checkpoints go to the volume /runs.
#
#   docker build -f docker/training.Dockerfile -t rollcast-training .
#   docker run -v rollcast-runs:/runs rollcast-training train field-one-ball
#
# TORCH_INSTALL_ARGS may give pip further arguments for torch (an index with the wanted build).

FROM docker.io/library/python:3.11-slim-bookworm AS build
ARG TORCH_INSTALL_ARGS=""
COPY tools/uv.txt /tmp/
RUN python -m venv /opt/uv \
    && /opt/uv/bin/pip install --no-cache-dir --no-input --require-hashes -r /tmp/uv.txt
ENV UV_COMPILE_BYTECODE=1 \
    UV_PROJECT_ENVIRONMENT=/opt/rollcast \
    UV_PYTHON_DOWNLOADS=never \
    UV_SYSTEM_CERTS=1
WORKDIR /build
COPY pyproject.toml uv.lock ./
# torch by pip, as in tools/environment.sh.
RUN /opt/uv/bin/uv sync --no-cache --frozen --no-install-project --no-install-package torch \
        --python python --extra training \
    && /opt/uv/bin/pip --python /opt/rollcast/bin/python install --no-cache-dir --no-input --no-deps \
        ${TORCH_INSTALL_ARGS} "$(grep -o 'torch==[0-9.]*' pyproject.toml)" \
    && /opt/uv/bin/uv pip check --python /opt/rollcast/bin/python

FROM docker.io/library/python:3.11-slim-bookworm
LABEL org.opencontainers.image.title="Rollcast training" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="0.1.0"
RUN useradd --system --uid 10001 --user-group --no-create-home rollcast \
    && install -d -o rollcast -g rollcast /runs
COPY --from=build /opt/rollcast /opt/rollcast
WORKDIR /app
COPY LICENSE ./
COPY rollcast rollcast
COPY training training
COPY models models
ENV PATH=/opt/rollcast/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    ROLLCAST_RUNS=/runs
VOLUME /runs
USER 10001:10001
ENTRYPOINT ["python", "-m", "training"]
CMD ["--help"]
