//! Debian's Chromium, driven through WebDriver. On every page it checks that the console has no errors and that no other host is requested.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use thirtyfour::prelude::*;

const AXE: &str = include_str!("../data/axe-core/axe.min.js");
/// Timeout that no page exceeds, even on a busy machine with an unoptimised build.
const PATIENCE: Duration = Duration::from_secs(60);
/// Window sizes, and widths of pictures: a small desktop and a tablet.
pub const DESKTOP: (u32, u32) = (1280, 900);
pub const TABLET: (u32, u32) = (768, 1024);
pub const PHONE: (u32, u32) = (390, 844);

/// `chromedriver` on a free port.
pub struct Driver {
    child: Child,
    url: String,
}

impl Driver {
    /// Starts it; `None`, with a message, if Chromium is not installed. KINCAL_EXPECT_BROWSER makes that an error.
    pub fn start() -> Option<Self> {
        // It takes a free port of IPv4 and then the same one of IPv6. It ends if another process has taken that one meanwhile.
        (0..5)
            .find_map(|_| match Self::spawn() {
                Ok(driver) => driver.map(Some),
                Err(error) => {
                    assert!(
                        std::env::var_os("KINCAL_EXPECT_BROWSER").is_none(),
                        "chromedriver is expected here: {error}"
                    );
                    eprintln!(
                        "SKIPPED: no chromedriver here; apt-get install chromium chromium-driver"
                    );
                    Some(None)
                }
            })
            .expect("chromedriver starts and names its port")
    }

    /// `None` if it ended before it listened.
    fn spawn() -> std::io::Result<Option<Self>> {
        let mut child = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let mut lines = BufReader::new(child.stdout.take().unwrap())
            .lines()
            .map_while(Result::ok);
        let port = lines.find_map(|line| {
            line.rsplit_once("successfully on port ")
                .map(|(_, port)| port.trim_end_matches('.').to_owned())
        });
        let Some(port) = port else {
            child.wait()?;
            return Ok(None);
        };
        // Reads on, so that chromedriver can always write.
        std::thread::spawn(move || lines.for_each(drop));
        Ok(Some(Self {
            child,
            url: format!("http://127.0.0.1:{port}"),
        }))
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Window size and theme of a browser.
#[derive(Clone, Copy)]
pub struct Look {
    pub size: (u32, u32),
    pub dark: bool,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            size: DESKTOP,
            dark: false,
        }
    }
}

/// One window on one server.
pub struct Browser {
    driver: WebDriver,
    server: String,
}

impl Browser {
    /// Opens a window.
    pub async fn open(driver: &Driver, server: &str, look: Look) -> Self {
        let mut capabilities = DesiredCapabilities::chrome();
        for argument in [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
        ] {
            capabilities.add_arg(argument).unwrap();
        }
        capabilities
            .set(
                "goog:loggingPrefs",
                json!({"browser": "ALL", "performance": "ALL"}),
            )
            .unwrap();
        kincal::http::tls::use_ring();
        let client = reqwest::Client::builder()
            .no_proxy()
            .timeout(PATIENCE)
            .build()
            .unwrap();
        let driver = WebDriver::builder(driver.url.as_str(), capabilities)
            .client(client)
            .connect()
            .await
            .expect("Chromium starts");
        driver.set_script_timeout(PATIENCE).await.unwrap();
        let browser = Self {
            driver,
            server: server.into(),
        };
        browser.look(look).await;
        browser
    }

    /// Changes size and theme.
    pub async fn look(&self, look: Look) {
        let metrics = json!({"width": look.size.0, "height": look.size.1, "deviceScaleFactor": 1, "mobile": false});
        self.devtools("Emulation.setDeviceMetricsOverride", metrics)
            .await;
        let scheme = if look.dark { "dark" } else { "light" };
        self.devtools(
            "Emulation.setEmulatedMedia",
            json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]}),
        )
        .await;
    }

    async fn devtools(&self, method: &str, parameters: Value) -> Value {
        self.driver
            .cdp()
            .send_raw(method, parameters)
            .await
            .unwrap()
    }

    /// Opens an address of the server, and waits until the page is loaded.
    pub async fn go(&self, path: &str) {
        // Otherwise an address that differs only in its fragment would not be loaded again.
        self.driver.goto("about:blank").await.unwrap();
        self.driver
            .goto(format!("{}{path}", self.server))
            .await
            .unwrap();
        self.settled().await;
    }

    /// Opens a file.
    pub async fn go_to_file(&self, path: &Path) {
        self.driver
            .goto(format!("file://{}", path.display()))
            .await
            .unwrap();
    }

    /// Waits until nothing is being loaded.
    pub async fn settled(&self) {
        self.until("document.readyState === 'complete' && document.querySelector('h1') && !document.querySelector('[aria-busy]')").await;
    }

    /// Runs a script and returns its result.
    pub async fn run(&self, script: &str) -> Value {
        self.driver
            .execute(script, vec![])
            .await
            .unwrap_or_else(|e| panic!("{script}: {e}"))
            .json()
            .clone()
    }

    /// Waits until an expression is true.
    pub async fn until(&self, expression: &str) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            if self.run(&format!("return Boolean({expression})")).await == true {
                return;
            }
            assert!(
                Instant::now() < deadline,
                "{expression} did not come true; the page says:\n{}",
                self.text().await
            );
            tokio::time::sleep(Duration::from_millis(40)).await;
        }
    }

    /// Waits until the page contains a text.
    pub async fn until_it_says(&self, text: &str) {
        self.until(&format!(
            "document.body.innerText.includes({})",
            json!(text)
        ))
        .await;
    }

    /// All visible text.
    pub async fn text(&self) -> String {
        self.run("return document.body.innerText")
            .await
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// The visible button with this name.
    pub async fn button(&self, name: &str) -> WebElement {
        let path =
            format!("//button[normalize-space(.)={name:?} and not(ancestor::dialog[not(@open)])]");
        self.driver
            .query(By::XPath(path))
            .and_displayed()
            .first()
            .await
            .unwrap_or_else(|e| panic!("no button {name}: {e}"))
    }

    /// First element that matches a selector.
    pub async fn find(&self, css: &str) -> WebElement {
        self.driver
            .query(By::Css(css))
            .first()
            .await
            .unwrap_or_else(|e| panic!("no {css}: {e}"))
    }

    /// Drags a file of this content over an element and drops it there.
    pub async fn drop_file(&self, css: &str, name: &str, content: &str) {
        let script = "const [css, name, content] = arguments; const dataTransfer = new DataTransfer(); \
            dataTransfer.items.add(new File([content], name)); \
            for (const kind of ['dragover', 'drop']) \
            document.querySelector(css).dispatchEvent(new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));";
        self.driver
            .execute(script, vec![json!(css), json!(name), json!(content)])
            .await
            .unwrap();
    }

    /// Sets the folder of this window's downloads.
    pub async fn download_to(&self, folder: &Path) {
        std::fs::create_dir_all(folder).unwrap();
        self.devtools(
            "Browser.setDownloadBehavior",
            json!({"behavior": "allow", "downloadPath": folder}),
        )
        .await;
    }

    /// Waits until a download whose name ends like this is complete, and returns its path.
    pub async fn downloaded(&self, folder: &Path, ending: &str) -> PathBuf {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let files = std::fs::read_dir(folder).into_iter().flatten();
            let mut paths = files.map(|file| file.unwrap().path());
            let is_it = |path: &PathBuf| path.to_string_lossy().ends_with(ending);
            if let Some(path) = paths.find(is_it) {
                return path;
            }
            assert!(Instant::now() < deadline, "{ending} was not downloaded");
            tokio::time::sleep(Duration::from_millis(40)).await;
        }
    }

    /// Waits until a download is complete: Chromium gives the file its name at the end.
    pub async fn until_there_is(&self, file: &Path) {
        let deadline = Instant::now() + PATIENCE;
        while !file.exists() {
            assert!(
                Instant::now() < deadline,
                "{} was not downloaded",
                file.display()
            );
            tokio::time::sleep(Duration::from_millis(40)).await;
        }
    }

    /// Clicks at a place relative to the middle of an element, px.
    pub async fn click_at(&self, css: &str, x: i64, y: i64) {
        let element = self.find(css).await;
        let chain = self.driver.action_chain();
        let chain = chain.move_to_element_with_offset(&element, x, y);
        chain.click().perform().await.unwrap();
    }

    /// Opens a tab of the same browser and goes on there.
    pub async fn new_tab(&self) {
        let tab = self.driver.new_tab().await.unwrap();
        self.driver.switch_to_window(tab).await.unwrap();
    }

    /// Sets a cookie that no script could set.
    pub async fn set_cookie(&self, name: &str, value: &str, path: &str) {
        let cookie = json!({"name": name, "value": value, "path": path, "url": self.server, "httpOnly": true, "sameSite": "Strict"});
        self.devtools("Network.setCookie", cookie).await;
    }

    /// Selects the first point in the figure of the arm, by its key.
    pub async fn select_first_point(&self) {
        self.until("document.querySelector('canvas.scene')").await;
        self.run("document.querySelector('canvas.scene').focus()")
            .await;
        self.press("n").await;
    }

    /// Presses keys; the focused element receives them.
    pub async fn press(&self, keys: impl Into<TypingData>) {
        self.driver
            .action_chain()
            .send_keys(keys)
            .perform()
            .await
            .unwrap();
    }

    /// Violations that axe finds on the page.
    pub async fn accessibility(&self) -> Vec<String> {
        self.driver.execute(AXE, vec![]).await.unwrap();
        let run = "const done = arguments[0]; axe.run(document).then((r) => done(r.violations.map((v) => `${v.id}: ${v.nodes.map((n) => \
            n.html.slice(0, 200) + ' ' + n.failureSummary).join(' | ')}`)), (e) => done([String(e)]));";
        let found = self.driver.execute_async(run, vec![]).await.unwrap();
        found
            .json()
            .as_array()
            .unwrap()
            .iter()
            .map(|violation| violation.as_str().unwrap().to_owned())
            .collect()
    }

    /// Messages of the console since the last call.
    pub async fn console(&self) -> Vec<String> {
        let entries = self.driver.browser_log().await.unwrap();
        entries
            .into_iter()
            .map(|entry| format!("{}: {}", entry.level, entry.message))
            .collect()
    }

    /// Every address that was requested since the last call.
    pub async fn requests(&self) -> Vec<String> {
        let entries = self.driver.get_log("performance").await.unwrap();
        let messages = entries
            .iter()
            .map(|entry| serde_json::from_str::<Value>(&entry.message).unwrap()["message"].clone());
        let sent = messages.filter(|message| message["method"] == "Network.requestWillBeSent");
        sent.map(|message| {
            message["params"]["request"]["url"]
                .as_str()
                .unwrap()
                .to_owned()
        })
        .collect()
    }

    /// Asserts that the console has no messages except for answers of these statuses, and that only this server was requested.
    pub async fn assert_quiet(&self, expected_statuses: &[u16]) {
        let expected = |line: &String| {
            expected_statuses
                .iter()
                .any(|s| line.contains(&format!("the server responded with a status of {s}")))
        };
        let loud: Vec<String> = self
            .console()
            .await
            .into_iter()
            .filter(|line| !expected(line))
            .collect();
        assert!(loud.is_empty(), "the console says: {loud:#?}");
        let requests = self.requests().await;
        assert!(!requests.is_empty(), "the log of requests works");
        let own = |url: &String| {
            url.starts_with(&self.server)
                || url.starts_with(&format!("blob:{}", self.server))
                || url.starts_with("data:")
        };
        assert_eq!(requests.iter().find(|url| !own(url)), None);
    }

    /// Prints the page on A4 as PDF.
    pub async fn printed(&self) -> Vec<u8> {
        let parameters = json!({"preferCSSPageSize": true, "printBackground": false});
        let printed = self.devtools("Page.printToPDF", parameters).await;
        BASE64_STANDARD
            .decode(printed["data"].as_str().unwrap())
            .unwrap()
    }

    /// Saves a picture if requested: `KINCAL_SCREENSHOTS` names the folder of those in docs/, `KINCAL_PAGES` that of whole pages.
    pub async fn picture(&self, name: &str, of: Picture<'_>) {
        let variable = if matches!(of, Picture::Whole) {
            "KINCAL_PAGES"
        } else {
            "KINCAL_SCREENSHOTS"
        };
        let Some(folder) = std::env::var_os(variable).map(PathBuf::from) else {
            return;
        };
        tokio::time::sleep(Duration::from_millis(250)).await;
        // Hides the short notices, which would cover a figure in the picture.
        self.run("document.getElementById('said')?.style.setProperty('display', 'none')")
            .await;
        let clip = match of {
            Picture::Top(height) => {
                format!(
                    "[0, 0, innerWidth, Math.min({height}, Math.max(innerHeight, document.documentElement.scrollHeight))]"
                )
            }
            Picture::Whole => "[0, 0, innerWidth, document.documentElement.scrollHeight]".into(),
            Picture::Element(css) => format!(
                "(() => {{ const r = document.querySelector({}).getBoundingClientRect(); return [r.x + scrollX - 8, r.y + scrollY - 8, r.width + 16, r.height + 16]; }})()",
                json!(css)
            ),
        };
        let clip = self.run(&format!("return {clip}")).await;
        let clip =
            json!({"x": clip[0], "y": clip[1], "width": clip[2], "height": clip[3], "scale": 1});
        let taken = self
            .devtools(
                "Page.captureScreenshot",
                json!({"format": "png", "captureBeyondViewport": true, "clip": clip}),
            )
            .await;
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join(format!("{name}.png"));
        std::fs::write(
            &file,
            BASE64_STANDARD
                .decode(taken["data"].as_str().unwrap())
                .unwrap(),
        )
        .unwrap();
        // Visually the same picture in a third of the bytes. If pngquant is not installed, the file stays large.
        let _ = Command::new("pngquant")
            .args(["--force", "--speed=1", "--ext=.png", "128"])
            .arg(&file)
            .status();
    }

    /// Closes the window.
    pub async fn close(self) {
        self.driver.quit().await.unwrap();
    }
}

/// Part of a page that a picture shows.
pub enum Picture<'a> {
    /// The top of the page, at most this many pixels high.
    Top(u32),
    /// The whole page.
    Whole,
    /// One element.
    Element(&'a str),
}
