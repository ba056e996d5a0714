#!/usr/bin/env bash
# tests/generated_clients.sh: clients that openapi-python-client and openapi-typescript make from openapi.yaml run the whole workflow against a
# real server: robot, upload, job, wait, report, release. For the nightly run: it installs from PyPI and npm and takes some minutes.
# KINCAL_BIN names another binary than target/release/kincal.
set -euo pipefail
cd "$(dirname "$0")/.."

python_client=0.29.1 typescript=5.9.3 openapi_typescript=7.13.0 openapi_fetch=0.17.0 types_node=20.19.0
folder=$PWD/target/generated-clients
mkdir -p "$folder/typescript"

echo "== Python: openapi-python-client $python_client"
[ -x "$folder/venv/bin/python" ] || python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "openapi-python-client==$python_client"
# bodies that are not JSON are bytes to it
printf 'content_type_overrides:\n  text/csv: application/octet-stream\n  application/xml: application/octet-stream\n  application/vnd.openxmlformats-officedocument.spreadsheetml.sheet: application/octet-stream\n  application/vnd.oasis.opendocument.spreadsheet: application/octet-stream\n  application/yaml: application/octet-stream\n' >"$folder/config.yaml"
rm -rf "$folder/python"
"$folder/venv/bin/openapi-python-client" generate --path openapi.yaml --output-path "$folder/python" --config "$folder/config.yaml" --meta none

echo "== TypeScript: openapi-typescript $openapi_typescript"
cd "$folder/typescript"
cp ../../../tests/generated_clients/workflow.ts .
cat >package.json <<JSON
{"private": true, "type": "module", "dependencies": {"openapi-fetch": "$openapi_fetch"},
 "devDependencies": {"openapi-typescript": "$openapi_typescript", "typescript": "$typescript", "@types/node": "$types_node"}}
JSON
npm install --no-audit --no-fund --silent
npx openapi-typescript ../../../openapi.yaml --default-non-nullable=false --output contract.d.ts
npx tsc --strict --target es2022 --module nodenext --skipLibCheck --outDir js workflow.ts
cp package.json js/
cd - >/dev/null

echo "== The workflow"
ln -sfn "$folder/python" "$folder/kincal_client"
export PYTHONPATH=$folder
.ci/with-server bash -euo pipefail -c "
    '$folder/venv/bin/python' tests/generated_clients/workflow.py data/paper/robot.json data/paper/first_noisy.csv
    node '$folder/typescript/js/workflow.js' data/paper/robot.json data/paper/first_noisy.csv"
