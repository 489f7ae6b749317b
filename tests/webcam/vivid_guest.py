import os, time
t=time.time()
print(os.listdir("/dev") and [d for d in os.listdir("/dev") if "video" in d])
import numpy, asyncio
print("numpy", time.time()-t)
import cv2
print("cv2", time.time()-t)
