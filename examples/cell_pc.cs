// A cell PC in C#, one file, standard library only: upload a measurement set, have it identified, fetch the robot's active parameters.
//
//   Windows, with the compiler that every .NET Framework 4 brings along:
//     C:\Windows\Microsoft.NET\Framework64\v4.0.30319\csc.exe /r:System.Runtime.Serialization.dll cell_pc.cs
//   Linux:
//     mcs -r:System.Runtime.Serialization.dll cell_pc.cs
//
//   set KINCAL_KEY=...                                        the key, unless the server runs with --no-auth
//   set KINCAL_SERVER=http://127.0.0.1:8080                   the server, as for the command line; else KINCAL_URL
//   cell_pc.exe calibrate ROBOT_ID SET.csv [base|instrument]  upload, wait for the calibration, print what came out
//   cell_pc.exe fetch ROBOT_ID parameters.json                the released parameters, only if they changed, checked by their hash
//
// Every wait is bounded. What creates something carries an Idempotency-Key, so that it may be sent again when an answer got lost.
// Exit codes: 0 done, 1 failed, 2 refused: the request or the file has to be corrected.
using System;
using System.Globalization;
using System.IO;
using System.Net;
using System.Runtime.Serialization;
using System.Runtime.Serialization.Json;
using System.Security.Cryptography;
using System.Text;
using System.Threading;

// Fields of the answers that are read; all others are ignored.
public class MeasurementSet { public string id; public Warning[] warnings; }
public class Job { public string id, status, parameter_set_id; public Problem error; }
public class Report { public Half identify, verify; public Warning[] warnings; }
public class Half { public int n_points; public Errors before, after; }
public class Errors { public double rms_mm; }
public class ParameterSet { public string id, sha256, released_at; }
public class Warning { public string code, detail; }
public class Problem { public string code, detail; public Warning[] errors; }

/// <summary>The service understood and said no; its problem document says why.</summary>
class Refused : Exception
{
    public readonly int Status;
    public Refused(int status, string text) : base(text) { Status = status; }
}

class Answer
{
    public int Status;
    public string ETag;
    public byte[] Bytes;
}

class Kincal
{
    const int Tries = 5;
    const int RequestTimeoutMs = 40000;
    const int LongestPauseS = 10;
    readonly string url, key;

    public Kincal(string url, string key) { this.url = url.TrimEnd('/'); this.key = key; }

    public T Get<T>(string path) { return Read<T>(Send("GET", path, null, null, null).Bytes); }

    public T Post<T>(string path, byte[] body, string contentType) { return Read<T>(Send("POST", path, body, contentType, null).Bytes); }

    /// <summary>One request, repeated while the network or the server is not there.</summary>
    public Answer Send(string method, string path, byte[] body, string contentType, string knownETag)
    {
        string idempotencyKey = Guid.NewGuid().ToString("N");
        for (int attempt = 1; ; attempt++)
        {
            double pauseS = attempt;
            try { return Once(method, path, body, contentType, knownETag, idempotencyKey); }
            catch (WebException error)
            {
                var answer = error.Response as HttpWebResponse;
                if (answer == null)
                {
                    if (attempt == Tries) throw new IOException(url + " does not answer: " + error.Message);
                }
                else using (answer)
                {
                    int status = (int)answer.StatusCode;
                    if (status == 304) return new Answer { Status = 304, ETag = knownETag };
                    if ((status != 429 && status != 503) || attempt == Tries) throw new Refused(status, ProblemText(status, Bytes(answer)));
                    double.TryParse(answer.Headers["Retry-After"] ?? "", NumberStyles.Float, CultureInfo.InvariantCulture, out pauseS);
                }
            }
            Thread.Sleep(TimeSpan.FromSeconds(Math.Max(1, Math.Min(pauseS, LongestPauseS))));
        }
    }

    Answer Once(string method, string path, byte[] body, string contentType, string knownETag, string idempotencyKey)
    {
        var request = (HttpWebRequest)WebRequest.Create(url + path);
        request.Method = method;
        request.Proxy = null; // a cell's network has no proxy between this computer and the server
        request.Timeout = request.ReadWriteTimeout = RequestTimeoutMs;
        request.ServicePoint.Expect100Continue = false;
        if (!string.IsNullOrEmpty(key)) request.Headers["Authorization"] = "Bearer " + key;
        if (knownETag != null) request.Headers["If-None-Match"] = knownETag;
        if (method == "POST")
        {
            request.Headers["Idempotency-Key"] = idempotencyKey;
            request.ContentType = contentType;
            request.ContentLength = body.Length;
            using (var stream = request.GetRequestStream()) stream.Write(body, 0, body.Length);
        }
        using (var answer = (HttpWebResponse)request.GetResponse())
            return new Answer { Status = (int)answer.StatusCode, ETag = answer.Headers["ETag"], Bytes = Bytes(answer) };
    }

    static byte[] Bytes(WebResponse answer)
    {
        using (var stream = answer.GetResponseStream())
        using (var bytes = new MemoryStream()) { stream.CopyTo(bytes); return bytes.ToArray(); }
    }

    public static T Read<T>(byte[] json)
    {
        using (var stream = new MemoryStream(json)) return (T)new DataContractJsonSerializer(typeof(T)).ReadObject(stream);
    }

    /// <summary>The problem's sentence and every single reason.</summary>
    static string ProblemText(int status, byte[] body)
    {
        Problem problem;
        try { problem = Read<Problem>(body); }
        catch (SerializationException) { return "the server answered " + status; }
        var text = new StringBuilder(problem.detail + " (" + problem.code + ")");
        foreach (var issue in problem.errors ?? new Warning[0]) text.Append("\n  " + issue.detail);
        return text.ToString();
    }
}

static class CellPc
{
    const int WaitS = 20;
    static readonly TimeSpan JobTimeout = TimeSpan.FromMinutes(30);

    static void Calibrate(Kincal server, string robot, string file, string frame)
    {
        string name = Uri.EscapeDataString(Path.GetFileNameWithoutExtension(file));
        string path = "/v1/robots/" + robot + "/measurement-sets?frame=" + frame + "&name=" + name;
        var set = server.Post<MeasurementSet>(path, File.ReadAllBytes(file), "text/csv");
        Warn(set.warnings);
        byte[] request = Encoding.UTF8.GetBytes("{\"measurement_set_id\": \"" + set.id + "\"}");
        var job = server.Post<Job>("/v1/robots/" + robot + "/jobs", request, "application/json");
        DateTime deadline = DateTime.UtcNow + JobTimeout;
        while (job.status == "queued" || job.status == "running")
        {
            if (DateTime.UtcNow > deadline) throw new IOException("job " + job.id + " is still " + job.status + "; ask for it later");
            // answers when the status changes, at the latest after WaitS
            job = server.Get<Job>("/v1/jobs/" + job.id + "?wait_s=" + WaitS);
        }
        if (job.status != "succeeded") throw new IOException("job " + job.id + " " + job.status + (job.error == null ? "" : " " + job.error.detail));
        var report = server.Get<Report>("/v1/jobs/" + job.id + "/report");
        Print("identify", report.identify);
        Print("verify", report.verify);
        Warn(report.warnings);
        Console.WriteLine("parameter set " + job.parameter_set_id + " is a candidate until it is released");
    }

    static void Print(string name, Half half)
    {
        if (half == null) return;
        string text = "{0}: {1} points, rms {2:F4} mm before, {3:F4} mm after";
        Console.WriteLine(string.Format(CultureInfo.InvariantCulture, text, name, half.n_points, half.before.rms_mm, half.after.rms_mm));
    }

    static void Warn(Warning[] warnings)
    {
        foreach (var warning in warnings) Console.Error.WriteLine("warning (" + warning.code + "): " + warning.detail);
    }

    static void Fetch(Kincal server, string robot, string file)
    {
        string etagFile = file + ".etag", part = file + ".part";
        string known = File.Exists(etagFile) && File.Exists(file) ? File.ReadAllText(etagFile) : null;
        Answer active = server.Send("GET", "/v1/robots/" + robot + "/parameter-sets/active", null, null, known);
        if (active.Status == 304) { Console.WriteLine("unchanged"); return; }
        var set = Kincal.Read<ParameterSet>(active.Bytes);
        // what the hash covers: hash the bytes as they came, and only then use them
        byte[] content = server.Send("GET", "/v1/parameter-sets/" + set.id + "/content", null, null, null).Bytes;
        string found;
        using (var sha256 = SHA256.Create()) found = BitConverter.ToString(sha256.ComputeHash(content)).Replace("-", "").ToLowerInvariant();
        if (found != set.sha256) throw new IOException("parameter set " + set.id + " is damaged: its SHA-256 is " + found + ", not " + set.sha256);
        // written beside and moved: whoever reads the file finds the old parameters or the new ones, never half of them
        File.WriteAllBytes(part, content);
        if (File.Exists(file)) File.Replace(part, file, null);
        else File.Move(part, file);
        File.WriteAllText(etagFile, active.ETag);
        Console.WriteLine("fetched " + set.id + ", released " + set.released_at + ", SHA-256 " + found + " checked");
    }

    static int Main(string[] arguments)
    {
        ServicePointManager.SecurityProtocol |= (SecurityProtocolType)3072; // TLS 1.2, which old .NET Frameworks do not ask for by themselves
        string url = Environment.GetEnvironmentVariable("KINCAL_SERVER") ?? Environment.GetEnvironmentVariable("KINCAL_URL") ?? "http://127.0.0.1:8080";
        var server = new Kincal(url, Environment.GetEnvironmentVariable("KINCAL_KEY"));
        try
        {
            if (arguments.Length >= 3 && arguments[0] == "calibrate") Calibrate(server, arguments[1], arguments[2], arguments.Length > 3 ? arguments[3] : "base");
            else if (arguments.Length == 3 && arguments[0] == "fetch") Fetch(server, arguments[1], arguments[2]);
            else { Console.Error.WriteLine("cell_pc calibrate ROBOT_ID SET.csv [base|instrument]\ncell_pc fetch ROBOT_ID parameters.json"); return 2; }
            return 0;
        }
        catch (Refused refused) { Console.Error.WriteLine(refused.Message); return refused.Status < 500 ? 2 : 1; }
        catch (IOException error) { Console.Error.WriteLine(error.Message); return 1; }
    }
}
