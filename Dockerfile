# The README's two commands: the first while the image is built, the second when it runs.
#   docker build -t tepm-opt . && docker run --rm tepm-opt
FROM python:3.12-slim
RUN useradd --create-home lab
USER lab
WORKDIR /home/lab/tepm-opt
COPY --chown=lab . .
RUN python3 -m venv --upgrade-deps .venv && .venv/bin/pip install --no-compile . && .venv/bin/tepm demo --out demo
CMD python3 -m venv --upgrade-deps .venv && .venv/bin/pip install --no-compile -e '.[test]' && .venv/bin/pytest -n 2
