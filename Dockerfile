# Two stages: the build tools stay in the first one.
FROM python:3.11-slim@sha256:9c900dea9e8fb7e16277c179b555cc72d29a352dbc33cff48ad5a0412fd5bfc7 AS build
WORKDIR /build
COPY pyproject.toml README.md LICENSE ./
COPY requirements/runtime.lock requirements/runtime.lock
COPY monitor_core monitor_core
COPY service service
COPY preload_client preload_client
COPY replay_data replay_data
RUN python -m venv /opt/preload \
 && /opt/preload/bin/pip install --no-cache-dir --no-deps --require-hashes -r requirements/runtime.lock \
 && /opt/preload/bin/pip install --no-cache-dir --no-deps --no-build-isolation .

FROM python:3.11-slim@sha256:9c900dea9e8fb7e16277c179b555cc72d29a352dbc33cff48ad5a0412fd5bfc7
RUN useradd --system --create-home --uid 10001 preload && install -d -o preload /var/lib/preload
COPY --from=build /opt/preload /opt/preload
USER preload
ENV PATH=/opt/preload/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PRELOAD_DATA_DIR=/var/lib/preload \
    PRELOAD_HOST=0.0.0.0 \
    PRELOAD_PORT=8710
VOLUME /var/lib/preload
EXPOSE 8710
HEALTHCHECK --interval=10s --timeout=3s --start-period=20s \
  CMD python -c "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8710/readyz', timeout=2)"
CMD ["preload", "serve"]
