# A cell PC in PowerShell (Windows PowerShell 5.1 or later): upload a measurement set, have it identified, fetch the active parameters.
#
#   $env:KINCAL_KEY = '...'                                       the key, unless the server runs with --no-auth
#   .\cell_pc.ps1 calibrate -Robot ROBOT_ID -File set.csv         upload, wait for the calibration, show what came out
#   .\cell_pc.ps1 fetch -Robot ROBOT_ID -File parameters.json     the released parameters, checked by their hash
#
# Every wait is bounded. What creates something carries an Idempotency-Key: it may be sent again when an answer got lost.
param(
    [Parameter(Mandatory, Position = 0)][ValidateSet('calibrate', 'fetch')][string]$Command,
    [Parameter(Mandatory)][string]$Robot,
    [Parameter(Mandatory)][string]$File,
    [ValidateSet('base', 'instrument')][string]$Frame = 'base',
    [string]$Server = $(if ($env:KINCAL_URL) { $env:KINCAL_URL } else { 'http://127.0.0.1:8080' })
)
$ErrorActionPreference = 'Stop'
$Tries = 5
$JobTimeoutMinutes = 30

function Send-Request($Method, $Path, $InFile, $Body, $ContentType, $OutFile) {
    $request = @{ Method = $Method; Uri = "$Server$Path"; Headers = @{}; TimeoutSec = 40; UseBasicParsing = $true }
    if ($env:KINCAL_KEY) { $request.Headers['Authorization'] = "Bearer $env:KINCAL_KEY" }
    if ($Method -eq 'Post') { $request.Headers['Idempotency-Key'] = [guid]::NewGuid().ToString('N') }
    if ($InFile) { $request.InFile = $InFile }
    if ($Body) { $request.Body = $Body }
    if ($ContentType) { $request.ContentType = $ContentType }
    if ($OutFile) { $request.OutFile = $OutFile }
    for ($try = 1; ; $try++) {
        try {
            if ($OutFile) { return Invoke-WebRequest @request }
            return Invoke-RestMethod @request
        }
        catch {
            # an answer is an answer; only what got none, or 429 and 503, is sent again
            $status = if ($_.Exception.Response) { [int]$_.Exception.Response.StatusCode } else { 0 }
            if ($try -ge $Tries -or $status -notin 0, 429, 503) { throw }
            Start-Sleep -Seconds $try
        }
    }
}

if ($Command -eq 'calibrate') {
    $name = [uri]::EscapeDataString([IO.Path]::GetFileNameWithoutExtension($File))
    $set = Send-Request Post "/v1/robots/$Robot/measurement-sets?frame=$Frame&name=$name" -InFile $File -ContentType 'text/csv'
    $set.warnings | ForEach-Object { Write-Warning $_.detail }
    $request = @{ measurement_set_id = $set.id } | ConvertTo-Json
    $job = Send-Request Post "/v1/robots/$Robot/jobs" -Body $request -ContentType 'application/json'
    $deadline = (Get-Date).AddMinutes($JobTimeoutMinutes)
    while ($job.status -in 'queued', 'running') {
        if ((Get-Date) -gt $deadline) { throw "job $($job.id) is still $($job.status); ask for it later" }
        $job = Send-Request Get "/v1/jobs/$($job.id)?wait_s=20"
    }
    if ($job.status -ne 'succeeded') { throw "job $($job.id) $($job.status): $($job.error.detail)" }
    $report = Send-Request Get "/v1/jobs/$($job.id)/report"
    if ($report.verify) { "verify: rms {0:N4} mm before, {1:N4} mm after" -f $report.verify.before.rms_mm, $report.verify.after.rms_mm }
    "parameter set $($job.parameter_set_id) is a candidate until it is released"
}
else {
    $active = Send-Request Get "/v1/robots/$Robot/parameter-sets/active"
    # the bytes that the hash covers, as they come: hash the file, compare, and only then put it in its place
    $part = "$File.part"
    Send-Request Get "/v1/parameter-sets/$($active.id)/content" -OutFile $part | Out-Null
    $found = (Get-FileHash -Algorithm SHA256 -Path $part).Hash.ToLowerInvariant()
    if ($found -ne $active.sha256) { Remove-Item $part; throw "parameter set $($active.id) is damaged: $found is not $($active.sha256)" }
    Move-Item -Force -Path $part -Destination $File
    "fetched $($active.id), released $($active.released_at), SHA-256 checked"
}
