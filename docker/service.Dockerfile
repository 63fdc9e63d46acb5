# The service with its models, without torch.
#
#   docker build -f docker/service.Dockerfile -t rollcast-service:0.1.0 .
#   docker run --read-only --tmpfs /tmp -e ROLLCAST_ALLOW_UNAUTHENTICATED=true -p 127.0.0.1:8000:8000 rollcast-service:0.1.0
#
# Where others reach the port, it wants a file of API keys: docs/guide/deployment.md. Any user may run
# it, also one without a name.
#
# With Ray, for docker/kubernetes/ray.yaml:
#
#   docker build -f docker/service.Dockerfile --build-arg EXTRA=ray -t rollcast-ray:0.1.0 .

FROM docker.io/library/python:3.11-slim-bookworm AS build
ARG EXTRA=service
COPY tools/uv.txt /tmp/
RUN python -m venv /opt/uv \
    && /opt/uv/bin/pip install --no-cache-dir --no-input --require-hashes -r /tmp/uv.txt
ENV UV_PROJECT_ENVIRONMENT=/opt/rollcast \
    UV_PYTHON_DOWNLOADS=never \
    UV_SYSTEM_CERTS=1
WORKDIR /build
COPY pyproject.toml uv.lock ./
RUN /opt/uv/bin/uv sync --no-cache --frozen --no-install-project --python python \
        --extra simulation --extra "${EXTRA}" \
    && /opt/uv/bin/uv pip check --python /opt/rollcast/bin/python
# The service simulates against its own surfaces and draws its own pictures: PyBullet's robots, its
# learning environments and its renderer on a graphics card are not needed.
WORKDIR /opt/rollcast/lib/python3.11/site-packages
RUN rm -rf pybullet_data pybullet_envs pybullet_examples pybullet_robots pybullet_utils \
        eglRenderer*.so
WORKDIR /app
COPY rollcast rollcast
COPY service service
RUN /opt/rollcast/bin/python -m compileall -q -j 0 --invalidation-mode unchecked-hash \
        /opt/rollcast/lib /app

FROM docker.io/library/python:3.11-slim-bookworm
LABEL org.opencontainers.image.title="Rollcast" \
      org.opencontainers.image.description="Forecasts where rolling balls go from four video frames." \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="0.1.0"
RUN useradd --system --uid 10001 --user-group --no-create-home rollcast
COPY --from=build /opt/rollcast /opt/rollcast
COPY --from=build /app /app
COPY LICENSE /app/
COPY models /app/models
# The user has no home directory. Only Ray writes files, below HOME in the writable /tmp.
ENV PATH=/opt/rollcast/bin:$PATH \
    HOME=/tmp \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1
WORKDIR /app
USER 10001:10001
EXPOSE 8000
STOPSIGNAL SIGTERM
# http.client goes through no proxy of the environment.
HEALTHCHECK --interval=10s --timeout=3s --start-period=20s --retries=3 \
    CMD ["python", "-c", "import http.client; c = http.client.HTTPConnection('127.0.0.1', 8000, timeout=2); c.request('GET', '/health/live'); raise SystemExit(c.getresponse().status != 200)"]
ENTRYPOINT ["python", "-m", "service"]
# Within the container every address is meant: who reaches them is said where it is run.
CMD ["--host", "0.0.0.0", "--port", "8000"]
