"""The ground's page in headless Chromium, by Playwright, during a flight: what it shows, a killed process in its table, a click on
the map as a goal, the ground gone and back. Prints what it saw as JSON.

Usage: page.py URL SCREENSHOT.png PLANNER_PID GROUND_PID, then a line on standard input once the ground is back
"""
import json
import os
import signal
import sys
import time

from playwright.sync_api import sync_playwright

url, screenshot, planner, ground = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
errors = []

with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=os.environ.get("CHROMIUM", "/usr/bin/chromium"), args=["--no-sandbox"])
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(url)
    page.wait_for_selector("tr[data-process=planner]", timeout=20_000)
    page.wait_for_function("document.querySelectorAll('#facts dd')[1]?.textContent.includes('m')")
    # Killed, and seen.
    os.kill(planner, signal.SIGKILL)
    killed = time.time()
    page.wait_for_function("document.querySelector('tr[data-process=planner] td:nth-child(4)')?.textContent === '1'", timeout=10_000)
    seen_s = time.time() - killed
    # A click on the map, to the side of the way, is a goal.
    box = page.locator("#map").bounding_box()
    page.mouse.click(box["x"] + 0.7 * box["width"], box["y"] + 0.35 * box["height"])
    question = page.locator("#question").inner_text()
    page.locator("#yes").click()
    page.wait_for_function("document.querySelector('#said').textContent.includes('accepted')", timeout=10_000)
    page.wait_for_function("[...document.querySelectorAll('#facts dd')].some(fact => fact.textContent === '0 of 1 places passed')")
    page.screenshot(path=screenshot)
    assert not errors, errors
    # Without the ground the page says so; once it is back, so is the page.
    os.kill(ground, signal.SIGKILL)
    page.wait_for_function("document.querySelector('#alarms').textContent.includes('NOT ANSWERING')", timeout=15_000)
    print("gone", flush=True)
    sys.stdin.readline()
    page.wait_for_function("document.querySelector('#alarms').textContent === ''", timeout=20_000)
    refused = [error for error in errors if "ERR_CONNECTION_REFUSED" not in error and "ERR_CONNECTION_RESET" not in error and "ERR_EMPTY_RESPONSE" not in error]
    assert not refused, refused
    browser.close()
print(json.dumps({"seen_s": seen_s, "question": question}))
